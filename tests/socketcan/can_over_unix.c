/* A CAN socket for programs on a machine without SocketCAN, by LD_PRELOAD.

   socket(PF_CAN) gives a UNIX socket, which bind() connects to the path in CAN_OVER_UNIX. Frames
   are packets in the kernel's format, so reads and writes need no help. What else is asked of the
   socket succeeds and does nothing. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <net/if.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <sys/un.h>

static int ours = -1;

int socket(int domain, int type, int protocol) {
    int (*real)(int, int, int) = dlsym(RTLD_NEXT, "socket");
    if (domain != PF_CAN) return real(domain, type, protocol);
    return ours = real(AF_UNIX, SOCK_SEQPACKET, 0);
}

int bind(int fd, const struct sockaddr* address, socklen_t size) {
    int (*real)(int, const struct sockaddr*, socklen_t) = dlsym(RTLD_NEXT, "bind");
    if (fd != ours || address->sa_family != AF_CAN) return real(fd, address, size);
    struct sockaddr_un path = {.sun_family = AF_UNIX};
    strncpy(path.sun_path, getenv("CAN_OVER_UNIX"), sizeof(path.sun_path) - 1);
    return connect(fd, (struct sockaddr*)&path, sizeof(path));
}

int ioctl(int fd, unsigned long request, ...) {
    va_list more;
    va_start(more, request);
    void* argument = va_arg(more, void*);
    va_end(more);
    int (*real)(int, unsigned long, ...) = dlsym(RTLD_NEXT, "ioctl");
    if (fd != ours || request != SIOCGIFINDEX) return real(fd, request, argument);
    ((struct ifreq*)argument)->ifr_ifindex = 1;
    return 0;
}

int setsockopt(int fd, int level, int name, const void* value, socklen_t size) {
    int (*real)(int, int, int, const void*, socklen_t) = dlsym(RTLD_NEXT, "setsockopt");
    return fd == ours && level != SOL_SOCKET ? 0 : real(fd, level, name, value, size);
}

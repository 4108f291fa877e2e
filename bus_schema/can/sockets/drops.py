"""How many datagrams or frames the kernel could not put into the queue of a socket."""

from __future__ import annotations

import os
import socket
import struct

_SO_MEMINFO = 55
_MEMORY = struct.Struct("=9I")
"""SK_MEMINFO_VARS of linux/sock_diag.h; the last one is the count that SO_RXQ_OVFL tells too."""


def dropped_by_socket(descriptor: int) -> int:
    """How many were lost since the socket was opened, as its owner read too slowly.

    Those that a filter of the socket keeps out count too.

    Raises:
        OSError: it is no socket, or the kernel does not tell.
    """
    with socket.socket(fileno=os.dup(descriptor)) as receiver:
        told = receiver.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMORY.size)
    dropped: int = _MEMORY.unpack(told)[-1]
    return dropped

"""Runs a command, and says at its end what it took in CPU time, with all that it started.

What a shell's `times` counts leaves out processes that outlive their parent, as fork servers do for
a moment: here those are handed to this process (prctl(2), PR_SET_CHILD_SUBREAPER).
"""

import contextlib
import ctypes
import os
import resource
import signal
import subprocess
import sys
import time

PR_SET_CHILD_SUBREAPER = 36  # <linux/prctl.h>
GRACE_S = 5.0


def main() -> int:
    """Run it; its exit code."""
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1)
    command = subprocess.Popen(sys.argv[1:])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # it is for the command
    pid, status = 0, 0
    while pid != command.pid:
        pid, status = os.wait()
    give_up_s = time.monotonic() + GRACE_S
    with contextlib.suppress(ChildProcessError):  # no process is left
        while time.monotonic() < give_up_s:
            if os.waitpid(-1, os.WNOHANG)[0] == 0:
                time.sleep(0.05)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    in_all = used.ru_utime + used.ru_stime
    print(
        f"\n== CPU time: {in_all:.0f} s (user {used.ru_utime:.0f} s, system {used.ru_stime:.0f} s)"
    )
    return abs(os.waitstatus_to_exitcode(status))


if __name__ == "__main__":
    sys.exit(main())

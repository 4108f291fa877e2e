"""Run a command in a child process, so that an early end of the process is noticed."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import sys
from collections.abc import Callable

from bus_schema.runtime.limited_process import signal_name
from deploy.run.exit_codes import FAULT
from deploy.run.stop_signals import STOPS

_PR_SET_PDEATHSIG = 1  # <linux/prctl.h>


def run_watched(command: Callable[[], None]) -> None:
    """Run a command in a child of this process, and end with the child's exit code.

    A custom law may end the process it runs in, by `os._exit` or in C, with exit code 0. Only a
    command that returned or raised has come to its end; without that, the exit code is 1.
    """
    reader, writer = os.pipe()
    os.set_blocking(reader, False)
    watched = {*STOPS, signal.SIGCHLD}
    signal.pthread_sigmask(signal.SIG_BLOCK, watched)
    child = os.fork()
    if child == 0:
        os.setpgid(0, 0)  # Ctrl-C reaches it once, by its parent
        if sys.platform == "linux":
            ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, watched)
        try:
            command()
        finally:
            os.write(writer, b"ended")
        return
    code = _exit_code_of(child, watched)
    try:
        has_ended = bool(os.read(reader, 1))
    except BlockingIOError:  # a grandchild holds the other end
        has_ended = False
    if code < 0:
        print(f"error: the simulation was killed by {signal_name(-code)}", file=sys.stderr)
        with contextlib.suppress(OSError):  # of SIGKILL, which nobody can handle
            signal.signal(-code, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, watched)
        os.kill(os.getpid(), -code)
    if code == 0 and not has_ended:
        print("error: the law ended the process before the run was judged", file=sys.stderr)
        code = FAULT
    sys.exit(code)


def _exit_code_of(child: int, watched: set[signal.Signals]) -> int:
    """Forward signals to a child until it ends. Returns its exit code, negative for a signal."""
    while True:
        number = signal.sigwaitinfo(watched).si_signo
        if number != signal.SIGCHLD:
            os.kill(child, number)
            continue
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status)

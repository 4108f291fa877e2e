"""A child process that does not outlive its parent."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from types import FrameType

PR_SET_PDEATHSIG = 1  # <linux/prctl.h>
PROGRAM = "deploy.cli"
"""What a process of a run is, by name: the command line stands above this folder."""
SAFE_PATH, FOR_FORK_SERVER = "PYTHONSAFEPATH", "fork server"
"""While Python's fork server starts, by which it does not look for modules in this folder."""
_LEAVE_WITHIN_S = 30
"""Longer than any process takes to leave in order."""


def end_with_parent(parent_pid: int) -> None:
    """Have this process leave in order when its parent is gone, even if it is stopped by then.

    The signal asked for is SIGCONT: only that and SIGKILL reach a process that is stopped, and
    SIGKILL would leave no time to finish a file. To be called before anything that takes time, in
    the main thread. Where there is no Linux, nothing is asked for.

    Args:
        parent_pid: process id of the parent, which may be gone already.
    """

    def leave_without_parent(_number: int = 0, _frame: FrameType | None = None) -> None:
        if os.getppid() != parent_pid:
            signal.alarm(_LEAVE_WITHIN_S)  # ends a process that does not get round to leaving
            os.kill(os.getpid(), signal.SIGTERM)

    signal.signal(signal.SIGCONT, leave_without_parent)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGCONT)
    leave_without_parent()

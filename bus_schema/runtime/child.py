"""Child processes: how one ended, the last line it wrote, its end with its parent."""

from __future__ import annotations

import ctypes
import signal
import sys

PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER = 1, 36  # <linux/prctl.h>


def signal_name(number: int) -> str:
    """Return a signal's name, such as SIGABRT; real-time signals in between have none."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def how_it_ended(code: int) -> str:
    """Describe an exit code; a negative one is that of a signal."""
    return f"killed by {signal_name(-code)}" if code < 0 else f"ended with exit code {code}"


def last_line(output: str | bytes) -> str:
    """Return the last line that a process wrote; empty if it wrote none."""
    text = output.decode(errors="replace") if isinstance(output, bytes) else output
    return (text.strip().splitlines() or [""])[-1].strip()


def set_process_option(option: int, value: int) -> None:
    """Set an option of this process, see prctl(2); only Linux has them."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(option, value)

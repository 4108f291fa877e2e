"""The signals by which a user or the system asks a command to stop: Ctrl-C, SIGTERM, SIGHUP.

All mean the same, to every command: stop in order, and end with exit code 130.
"""

from __future__ import annotations

import signal
from collections.abc import Callable
from types import FrameType

from bus_schema.errors import Stopped

STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def on_stop(stop: Callable[[], None]) -> None:
    """Call `stop` for each of the signals; but not for SIGHUP under `nohup`."""

    def handle(_number: int, _frame: FrameType | None) -> None:
        stop()

    for number in STOPS:
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, handle)


def stop_at_once() -> Callable[[], bool]:
    """Have the signals raise `Stopped`.

    Returns:
        whether one has come: Python drops what is raised while it collects garbage.
    """
    has_come = False

    def stop() -> None:
        nonlocal has_come
        has_come = True
        raise Stopped

    on_stop(stop)
    return lambda: has_come


def ignore_stops() -> None:
    """From here on a request to stop comes too late, and must not kill what is leaving anyway."""
    for number in STOPS:
        signal.signal(number, signal.SIG_IGN)

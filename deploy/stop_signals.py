"""The signals by which a user or the system asks a command to stop: Ctrl-C, SIGTERM, SIGHUP.

All mean the same, to every command: stop in order, and end with exit code 130.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable
from multiprocessing import util
from types import FrameType
from typing import NoReturn

from bus_schema.errors import Stopped
from deploy.exit_codes import INTERRUPTED

STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
WITHIN_S = 5.0
"""In which what was asked to stop has to do so, where it may be code of the user's own."""
_deadlines: list[threading.Timer] = []
_has_come = threading.Event()


def on_stop(stop: Callable[[], None], within_s: float | None = None) -> None:
    """Call `stop` for each of the signals; but not for SIGHUP under `nohup`.

    Args:
        stop: what to call.
        within_s: so long after the first signal, or at the second, the process ends; unless what
            comes next has called this function again by then. None for no such limit.
    """
    _has_come.clear()
    while _deadlines:
        _deadlines.pop().cancel()

    def handle(_number: int, _frame: FrameType | None) -> None:
        if _deadlines:
            _end_now()
        if within_s is not None:
            _deadlines.append(threading.Timer(within_s, _end_now))
            _deadlines[0].daemon = True
            _deadlines[0].start()
        stop()

    for number in STOPS:
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, handle)


def _end_now() -> NoReturn:
    """End the process, whatever it does; files that are written as a whole stay as they were."""
    with contextlib.suppress(Exception):
        print("stopped: what was under way did not end by itself", file=sys.stderr, flush=True)
        sys.stdout.flush()
        util._run_finalizers()  # type: ignore[attr-defined]  # temporary folders
    os._exit(INTERRUPTED)


def stop_at_once() -> None:
    """Have the signals raise `Stopped`."""

    def stop() -> None:
        raise Stopped

    on_stop(stop)


def stop_between_steps() -> None:
    """Have the signals noted, for `end_if_asked` to look at."""
    on_stop(_has_come.set, WITHIN_S)


def end_if_asked() -> None:
    """Between two steps of work, raise `Stopped` if a request to stop has come meanwhile."""
    if _has_come.is_set():
        raise Stopped


def ignore_stops() -> None:
    """From here on a request to stop comes too late, and must not kill what is leaving anyway."""
    for number in STOPS:
        signal.signal(number, signal.SIG_IGN)

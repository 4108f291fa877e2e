"""Signals that ask a command to stop: Ctrl-C, SIGTERM, SIGHUP.

All have the same meaning for every command: stop in order, and end with exit code 130.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from types import FrameType
from typing import NoReturn

from bus_schema.errors import Stopped
from deploy.run.exit_codes import INTERRUPTED

STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
WITHIN_S = 5.0
"""Time to stop on request, where user code may not return."""
_deadlines: list[threading.Timer] = []
_lifelines: list[int] = []
"""At most one: the file descriptor by which a watcher learns that this process goes on."""
_has_come = threading.Event()


def on_stop(
    stop: Callable[[], None], within_s: float | None = None, *, may_hold_lock: bool = False
) -> None:
    """Call `stop` at each of the signals, except SIGHUP under `nohup`.

    Args:
        stop: what to call.
        within_s: the process ends this long after the first signal, or at the second, unless this
            function is called again by then. None for no such limit.
        may_hold_lock: user code may never release Python's lock, so that no handler runs: another
            process kills this one after twice that time.
    """
    _has_come.clear()
    while _deadlines:
        _deadlines.pop().cancel()
    while _lifelines:
        signal.set_wakeup_fd(-1)
        os.close(_lifelines.pop())
    if may_hold_lock and within_s is not None:
        _lifelines.append(_killer(2.0 * within_s))

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


def _killer(within_s: float) -> int:
    """Start a process that kills this one after a signal; closing the descriptor ends it."""
    read, write = os.pipe()
    os.set_blocking(write, False)
    signal.set_wakeup_fd(write, warn_on_full_buffer=False)  # Python's C code writes to it
    script = (
        f'test -n "$(head -c 1)" && ! timeout {within_s:g} cat && kill -KILL {os.getpid()}'
        " && echo \"stopped: code of the user's own held Python's lock, so it was killed\" >&2"
    )
    command = ["sh", "-c", script]
    subprocess.Popen(command, stdin=read, stdout=subprocess.DEVNULL, start_new_session=True)
    os.close(read)
    return write


def _end_now() -> NoReturn:
    """End the process at once; files that are written whole stay as they were."""
    with contextlib.suppress(Exception):
        print("stopped: the running operation did not end in time", file=sys.stderr, flush=True)
        sys.stdout.flush()
    os._exit(INTERRUPTED)


def stop_at_once(within_s: float | None = None, *, may_hold_lock: bool = False) -> None:
    """Make the signals raise `Stopped`; limits as for `on_stop`."""

    def stop() -> None:
        _has_come.set()
        raise Stopped

    on_stop(stop, within_s, may_hold_lock=may_hold_lock)


class StopRequest:
    """Flag set by a stop signal; the process checks it and leaves in order."""

    def __init__(self, then: Callable[[], None] | None = None) -> None:
        self._then = then
        self.is_set = False
        was_lost = _has_come.is_set()  # raised in a destructor or in a callback from C
        on_stop(self._set)
        if was_lost:
            self._set()

    def _set(self) -> None:
        self.is_set = True
        if self._then is not None:
            self._then()


def stop_between_steps() -> None:
    """Make the signals set a flag, which `end_if_asked` checks."""
    on_stop(_has_come.set, WITHIN_S)


def end_if_asked() -> None:
    """Raise `Stopped`, between two steps of work, if a stop was requested meanwhile.

    The exception of `stop_at_once` is lost in a destructor or in a callback from C.
    """
    if _has_come.is_set():
        raise Stopped


def ignore_stops() -> None:
    """Ignore stop requests from here on: the process is leaving anyway."""
    for number in STOPS:
        signal.signal(number, signal.SIG_IGN)

"""The signals by which a user or the system asks a command to stop: Ctrl-C, SIGTERM, SIGHUP.

All mean the same, to every command: stop in order, and end with exit code 130.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from multiprocessing import util
from types import FrameType
from typing import NoReturn

from bus_schema.errors import Stopped
from deploy.run.exit_codes import INTERRUPTED

STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
WITHIN_S = 5.0
"""In which what was asked to stop has to do so, where it may be code of the user's own."""
_deadlines: list[threading.Timer] = []
_lifelines: list[int] = []
"""At most one: the file descriptor by which a watcher learns that this process goes on."""
_has_come = threading.Event()


def on_stop(
    stop: Callable[[], None], within_s: float | None = None, *, may_hold_lock: bool = False
) -> None:
    """Call `stop` for each of the signals; but not for SIGHUP under `nohup`.

    Args:
        stop: what to call.
        within_s: so long after the first signal, or at the second, the process ends; unless what
            comes next has called this function again by then. None for no such limit.
        may_hold_lock: code of the user's own may never give up Python's lock, without which no
            handler runs: twice so long after a signal, another process kills this one.
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
    """Start what kills this process so long after a signal; closing the descriptor ends it."""
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
    """End the process, whatever it does; files that are written as a whole stay as they were."""
    with contextlib.suppress(Exception):
        print("stopped: what was under way did not end by itself", file=sys.stderr, flush=True)
        sys.stdout.flush()
        util._run_finalizers()  # type: ignore[attr-defined]  # temporary folders
    os._exit(INTERRUPTED)


def stop_at_once(within_s: float | None = None, *, may_hold_lock: bool = False) -> None:
    """Have the signals raise `Stopped`; limits as of `on_stop`."""

    def stop() -> None:
        _has_come.set()
        raise Stopped

    on_stop(stop, within_s, may_hold_lock=may_hold_lock)


class StopRequest:
    """Set by a signal to stop; a process looks at it and leaves in order."""

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
    """Have the signals noted, for `end_if_asked` to look at."""
    on_stop(_has_come.set, WITHIN_S)


def end_if_asked() -> None:
    """Between two steps of work, raise `Stopped` if a request to stop has come meanwhile.

    What `stop_at_once` raises is lost where it comes in a destructor or in a callback from C.
    """
    if _has_come.is_set():
        raise Stopped


def ignore_stops() -> None:
    """From here on a request to stop comes too late, and must not kill what is leaving anyway."""
    for number in STOPS:
        signal.signal(number, signal.SIG_IGN)

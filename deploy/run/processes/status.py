"""Status messages of a process: objects for the `run` that started it, or sentences."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Mapping
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

from bus_schema.units import split_unit
from deploy.run.console import Console
from plant_emulator.faults.process_faults import ProcessAction

_PROGRESS_EVERY_S = 5.0
_FOR_THE_JUDGE = ("kernel", "start_s", "newest_cycle_s")
"""Values that tell people nothing: identity of a clock, and times on it."""
_FLAGS = {"seed_used": ("random numbers drawn", "no random numbers drawn")}
"""Words for flags whose names are no words."""


class StatusMessage(NamedTuple):
    """A message of a process about itself.

    Attributes:
        role: the process: a `Role`, or the name of a process that is not on the bus.
        kind: ``note``, ``lacks``, ``warning``, ``fault``, ``realtime``, ``progress``,
            ``process_action``, ``result``, or ``compiles`` if it has to compile numerical kernels.
        values: content of this kind of message.
    """

    role: str
    kind: str
    values: dict[str, Any]


def in_words(values: Mapping[str, Any]) -> str:
    """Format values by name as a sentence: ``ticks 500, wall 0.5 s, rejected: none``."""
    told = (item for item in values.items() if item[0] not in _FOR_THE_JUDGE)
    return ", ".join(_value_in_words(name, value) for name, value in told)


def _value_in_words(name: str, value: Any) -> str:
    stem, unit = split_unit(name)
    title, suffix = stem.replace("_", " "), f" {unit}" if unit else ""
    match value:
        case bool():
            true, false = _FLAGS.get(name, (title, f"not {title}"))
            return true if value else false
        case dict():
            counted = {key: count for key, count in value.items() if count}
            return f"{title}: {in_words(counted) or 'none'}{suffix if counted else ''}"
        case float():
            return f"{title} {value:.4g}{suffix}"
        case _:
            return f"{title} {value}{suffix}"


class StatusReporter:
    """Sends the status messages of a process; safe for several threads.

    Args:
        role: the process.
        channel: receives kind and values; None for sentences to people.
    """

    def __init__(self, role: str, channel: Connection | None = None) -> None:
        self._role = role
        self._channel = channel
        self._lock = threading.Lock()
        self._console = Console(highlight=False)
        self._next_progress_s = time.monotonic()

    def report(self, kind: str, **values: Any) -> None:
        """Report a status; kinds as in `StatusMessage`."""
        if self._channel is not None:
            with self._lock, contextlib.suppress(OSError):  # no process reads it any longer
                self._channel.send((kind, values))
        elif kind in ("note", "lacks", "fault"):
            self._console.print(f"{self._role}: {values['text']}", markup=False)
        elif kind == "result" or (kind == "progress" and values and self._is_time_for_progress()):
            self._console.print(f"{self._role}: {in_words(values)}", markup=False)

    def _is_time_for_progress(self) -> bool:
        """Whether to show progress: `run` draws every message in a bar, people read a few lines."""
        now_s = time.monotonic()
        if now_s < self._next_progress_s:
            return False
        self._next_progress_s = now_s + _PROGRESS_EVERY_S
        return True

    def request(self, action: ProcessAction, *, await_execution: bool) -> None:
        """Request an action on a process from `run`; without `run` it is not done."""
        if self._channel is not None:
            self.report("process_action", action=action)
            if await_execution:
                with contextlib.suppress(OSError, EOFError):
                    self._channel.recv()

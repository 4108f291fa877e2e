"""Status messages of a process: objects for `run` that started it, or sentences for people."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Mapping
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

from rich.console import Console

from plant_emulator.faults.process_faults import ProcessAction

_PROGRESS_EVERY_S = 5.0
_UNITS = {"s": "s", "us": "µs", "mrad": "mrad"}
"""Of values whose names end in them."""


class StatusMessage(NamedTuple):
    """A message of a process about itself.

    Attributes:
        role: the process: a `Role`, or the name of one that is not on the bus.
        kind: ``note``, ``lacks``, ``fault``, ``realtime``, ``progress``, ``process_action``,
            ``result``, or ``compiles`` where it has numerical kernels to compile.
        values: what belongs to the kind.
    """

    role: str
    kind: str
    values: dict[str, Any]


def in_words(values: Mapping[str, Any]) -> str:
    """Values by name as a sentence for people: ``ticks 500, wall 0.5 s, rejected: none``."""
    return ", ".join(_value_in_words(name, value) for name, value in values.items())


def _value_in_words(name: str, value: Any) -> str:
    stem, _, unit = name.rpartition("_")
    title, suffix = (stem, f" {_UNITS[unit]}") if unit in _UNITS else (name, "")
    title = title.replace("_", " ")
    match value:
        case bool():
            return title if value else f"not {title}"
        case dict():
            counted = {key: count for key, count in value.items() if count}
            return f"{title}: {in_words(counted) or 'none'}{suffix if counted else ''}"
        case float():
            return f"{title} {value:.4g}{suffix}"
        case _:
            return f"{title} {value}{suffix}"


class StatusReporter:
    """Sends the status messages of a process; its threads may do so at once.

    Args:
        role: the process.
        channel: takes them, as kind and values; None for sentences to people.
    """

    def __init__(self, role: str, channel: Connection | None = None) -> None:
        self._role = role
        self._channel = channel
        self._lock = threading.Lock()
        self._console = Console(highlight=False)
        self._next_progress_s = time.monotonic()

    def report(self, kind: str, **values: Any) -> None:
        """Report something; the kinds are those of a `StatusMessage`."""
        if self._channel is not None:
            with self._lock, contextlib.suppress(OSError):  # nobody reads it any longer
                self._channel.send((kind, values))
        elif kind in ("note", "lacks", "fault"):
            self._console.print(f"{self._role}: {values['text']}", markup=False)
        elif kind == "result" or (kind == "progress" and values and self._is_time_for_progress()):
            self._console.print(f"{self._role}: {in_words(values)}", markup=False)

    def _is_time_for_progress(self) -> bool:
        """`run` draws a bar from every message; a person reads a line now and then."""
        now_s = time.monotonic()
        if now_s < self._next_progress_s:
            return False
        self._next_progress_s = now_s + _PROGRESS_EVERY_S
        return True

    def request(self, action: ProcessAction, *, await_execution: bool) -> None:
        """Have `run` do something to a process; without `run` nobody does."""
        if self._channel is not None:
            self.report("process_action", action=action)
            if await_execution:
                with contextlib.suppress(OSError, EOFError):
                    self._channel.recv()

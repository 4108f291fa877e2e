"""Trials in a forked child, so that a crash, a hang or a hunger for memory is a finding."""

from __future__ import annotations

import multiprocessing
import resource
import signal
import traceback
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path

_BUSY_S, _HANG_S = 60, 600
"""What no trial takes, of CPU time, and on a busy machine of wall time."""
_MEMORY_BYTES = 4 << 30


@dataclass
class Outcomes:
    """What came of trials.

    Attributes:
        counts: how many ended how.
        findings: those that ended as none may, by their number.
    """

    counts: Counter[str] = field(default_factory=Counter)
    findings: dict[int, str] = field(default_factory=dict)

    def note(self, number: int, kind: str, text: str) -> None:
        self.counts[kind] += 1
        if kind == "finding":
            self.findings[number] = text


def try_forked(trial: Callable[[int], str], numbers: range) -> Outcomes:
    """Make trials by number; each gives its outcome, or raises what is a finding.

    Args:
        trial: makes one; all that is random about it follows from its number.
        numbers: of the trials.
    """
    outcomes = Outcomes()
    while len(numbers):
        done = _one_child(trial, numbers, outcomes)
        numbers = numbers[done:]
    return outcomes


def _one_child(trial: Callable[[int], str], numbers: range, outcomes: Outcomes) -> int:
    """Make trials in one child until it is through, or dies; how many were made."""
    from_child, to_parent = multiprocessing.Pipe(duplex=False)
    fork = multiprocessing.get_context("fork")
    child = fork.Process(target=_be_child, args=(trial, numbers, to_parent))
    child.start()
    to_parent.close()
    done = 0
    with suppress(EOFError):
        while True:
            kind, text = from_child.recv()
            outcomes.note(numbers[done], kind, text)
            done += 1
    child.join()
    if child.exitcode:
        outcomes.note(numbers[done], "finding", f"the process died: exit code {child.exitcode}")
        done += 1
    return done


def _be_child(trial: Callable[[int], str], numbers: range, parent: Connection) -> None:
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + _MEMORY_BYTES, used + _MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.signal(signal.SIGPROF, signal.SIG_DFL)  # which ends C code too
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    for number in numbers:
        signal.setitimer(signal.ITIMER_PROF, _BUSY_S)
        signal.alarm(_HANG_S)
        try:
            answer = trial(number), ""
        except BaseException:  # noqa: BLE001 (whatever it is, it is a finding)
            answer = "finding", traceback.format_exc()
        parent.send(answer)

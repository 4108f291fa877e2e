"""Trials in a forked child, so that a crash, a hang or a hunger for memory is a finding."""

from __future__ import annotations

import multiprocessing
import resource
import signal
import traceback
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from functools import partial
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


class _Child:
    """A process that makes trials until it dies."""

    trial: Callable[[int], str]

    @classmethod
    def begin(cls, trial: Callable[[int], str]) -> None:
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + _MEMORY_BYTES, used + _MEMORY_BYTES))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        signal.signal(signal.SIGPROF, signal.SIG_DFL)  # which ends C code too
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        cls.trial = trial

    @classmethod
    def make(cls, number: int) -> tuple[str, str]:
        """Make a trial: its outcome, or that it is a finding and why."""
        signal.setitimer(signal.ITIMER_PROF, _BUSY_S)
        signal.alarm(_HANG_S)
        try:
            return cls.trial(number), ""
        except BaseException:  # noqa: BLE001 (any error is a finding)
            return "finding", traceback.format_exc()


def try_forked(trial: Callable[[int], str], numbers: range) -> Outcomes:
    """Make trials by number; each gives its outcome, or raises what is a finding.

    Args:
        trial: makes one; all that is random about it follows from its number.
        numbers: of the trials.
    """
    outcomes = Outcomes()
    start = partial(
        ProcessPoolExecutor, 1, multiprocessing.get_context("fork"), _Child.begin, (trial,)
    )
    children = start()
    for number in numbers:
        try:
            kind, text = children.submit(_Child.make, number).result()
        except BrokenProcessPool as error:
            kind, text = "finding", f"the process died: {error}"
            children = start()
        outcomes.counts[kind] += 1
        if kind == "finding":
            outcomes.findings[number] = text
    children.shutdown()
    return outcomes

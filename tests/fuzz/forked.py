"""Trials in a forked child, so that a crash, a hang or a hunger for memory is a finding."""

from __future__ import annotations

import json
import os
import resource
import signal
import traceback
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

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
    from_child, to_parent = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(from_child)
        with os.fdopen(to_parent, "w") as pipe:
            _be_child(trial, numbers, pipe)
        os._exit(0)
    os.close(to_parent)
    done = 0
    with os.fdopen(from_child) as pipe:
        for line in pipe:
            kind, text = json.loads(line)
            outcomes.counts[kind] += 1
            if kind == "finding":
                outcomes.findings[numbers[done]] = text
            done += 1
    _, status = os.waitpid(child, 0)
    if status:
        outcomes.counts["finding"] += 1
        outcomes.findings[numbers[done]] = f"the process died: wait status {status}"
        done += 1
    return done


def _be_child(trial: Callable[[int], str], numbers: range, pipe: IO[str]) -> None:
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + _MEMORY_BYTES, used + _MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.signal(signal.SIGPROF, signal.SIG_DFL)  # which ends C code too
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    for number in numbers:
        signal.setitimer(signal.ITIMER_PROF, _BUSY_S)
        signal.alarm(_HANG_S)
        try:
            answer = [trial(number), ""]
        except BaseException:  # noqa: BLE001 (whatever it is, it is a finding)
            answer = ["finding", traceback.format_exc()]
        pipe.write(json.dumps(answer) + "\n")
        pipe.flush()

"""The verdict on a run: only this module decides whether bounds were kept."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from enum import StrEnum
from typing import Any, Literal


class Verdict(StrEnum):
    """Verdicts on a run; only `KEPT` counts as kept, wherever runs are shown or counted.

    KEPT: every tick is known, none was outside, and the run ended without a fault. LOST: the error
    was outside its bounds at a tick. UNKNOWN: ticks are missing, or the recording is damaged or
    unfinished. FAULTED: something failed, inside the bounds or not. INTERRUPTED: the run was
    stopped before its end, inside its bounds until then. NOTHING: no tick was judged, or no command
    ever acted on the arm.

    Attributes:
        level: ``good``, ``bad`` or ``broken``, where the run cannot be judged as a whole.
        headline: its words above a report.
        listed: its words in a list of results.
    """

    level: Literal["good", "bad", "broken"]
    headline: str
    listed: str

    def __new__(cls, name: str, level: Any = "", headline: str = "", listed: str = "") -> Verdict:
        """Create a member whose value is its name in rows and summaries."""
        member = str.__new__(cls, name)
        member._value_ = name
        member.level, member.headline, member.listed = level, headline, listed
        return member

    KEPT = "kept", "good", "Bounds kept", "bounds kept"
    LOST = "lost", "bad", "Bounds not kept", "bounds not kept"
    UNKNOWN = "unknown", "broken", "Not known whether bounds were kept", "unknown"
    FAULTED = "faulted", "broken", "Run ended by a fault", "faulted"
    INTERRUPTED = "interrupted", "broken", "Run interrupted", "interrupted"
    NOTHING = "nothing", "broken", "Nothing was recorded", "incomplete"


def decide(
    faults: Collection[str] = (),
    *,
    is_judged: bool = False,
    was_outside: bool = False,
    is_known: bool = True,
    is_ended: bool = True,
) -> Verdict:
    """Return the verdict on a run.

    Args:
        faults: what failed.
        is_judged: a tick was judged, and a command acted.
        was_outside: the error was outside its bounds at a known tick.
        is_known: every tick is known, from an undamaged and finished recording.
        is_ended: the run reached its planned end.
    """
    if faults:
        return Verdict.FAULTED
    if not is_judged:
        return Verdict.NOTHING
    if was_outside:
        return Verdict.LOST
    if not is_known:
        return Verdict.UNKNOWN
    return Verdict.KEPT if is_ended else Verdict.INTERRUPTED


def verdict_of(summary: Mapping[str, Any]) -> Verdict:
    """Return the verdict in a summary; `NOTHING` for a missing or unknown one."""
    verdict = summary.get("verdict")
    return Verdict(verdict) if verdict in list(Verdict) else Verdict.NOTHING

"""The verdict on a run in words: how it ended, whether the bounds were kept, and why."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from deploy.runs.run_data import RunData

PARTIAL = "The recording is partial: it was not finished properly."
_SHOWN_FAULTS = 5


@dataclass(frozen=True)
class Verdict:
    """The top of a report.

    Attributes:
        level: ``good``, ``bad`` (bounds not kept), ``mixed`` (kept by some laws only) or ``broken``
            (no run to judge as a whole).
        headline: the verdict.
        reasons: what it rests on, a sentence each.
    """

    level: Literal["good", "bad", "mixed", "broken"]
    headline: str
    reasons: list[str]


def judge(run: RunData, summary: dict[str, Any]) -> Verdict:
    """The verdict on a run."""
    bounds = summary["bounds"]
    is_judged = bounds["violation_fraction"] is not None
    reasons = [*_trouble(run, summary), _bounds_sentence(summary)]
    if summary["completed"] and not summary["faults"] and is_judged:
        if bounds["kept"]:
            return Verdict("good", "Bounds kept", reasons)
        return Verdict("bad", "Bounds not kept", reasons)
    headline = "Run faulted" if summary["faults"] else "Run incomplete"
    if is_judged:
        headline += ", bounds kept until then" if bounds["kept"] else ", bounds not kept"
    return Verdict("broken", headline, reasons)


def _trouble(run: RunData, summary: dict[str, Any]) -> list[str]:
    """Everything that makes this less than a whole run."""
    faults = summary["faults"]
    trouble = [f"Fault of the {fault}" for fault in faults[:_SHOWN_FAULTS]]
    if len(faults) > _SHOWN_FAULTS:
        trouble.append(f"{len(faults) - _SHOWN_FAULTS} more faults are listed below.")
    if not run.complete:
        trouble.append(PARTIAL)
    planned_s = run.setup.scenario.duration_s
    if not summary["completed"] and summary["duration_s"] < planned_s:
        trouble.append(f"The data end at {summary['duration_s']:.3f} s of {planned_s:g} s planned.")
    if run.lost:
        missed = ", ".join(f"{topic} {count:,}" for topic, count in run.lost.items())
        trouble.append(f"The recording lacks {sum(run.lost.values()):,} messages: {missed}.")
    return trouble


def _bounds_sentence(summary: dict[str, Any]) -> str:
    bounds, ticks = summary["bounds"], summary["ticks"]
    if bounds["violation_fraction"] is None:
        return "No tick was recorded, so there is nothing to judge."
    if bounds["kept"]:
        return f"The true error of every joint was inside its bounds at all {ticks:,} ticks."
    return (
        f"The true error was outside its bounds at {100 * bounds['violation_fraction']:.3g} %"
        f" of the ticks, for the first time at {bounds['first_violation_s']:.3f} s."
    )

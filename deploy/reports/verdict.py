"""The verdict on a run, put into words; `deploy.runs.judging.verdict` is what decides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

from bus_schema.runtime.realtime import AFFINITY, SCHEDULER
from deploy.reports.tables import margin_text, number
from deploy.runs.conditions import granted_and_not
from deploy.runs.judging.bounds import plant_count
from deploy.runs.judging.known_ticks import KnownTicks, known_ticks
from deploy.runs.judging.stalls import STALL_MS
from deploy.runs.judging.verdict import Verdict, verdict_of
from deploy.runs.run_data import RunData

Level = Literal["good", "bad", "mixed", "broken"]
PARTIAL = "The recording is partial: it was not finished properly."
UNCHECKED = "No checksum covers all of the recording: damage between its messages would not show."

_HEADLINES: Mapping[Verdict, tuple[Level, str]] = {
    Verdict.KEPT: ("good", "Bounds kept"),
    Verdict.LOST: ("bad", "Bounds not kept"),
    Verdict.UNKNOWN: ("broken", "Not known whether bounds were kept"),
    Verdict.FAULTED: ("broken", "Run faulted"),
    Verdict.INTERRUPTED: ("broken", "Run incomplete"),
    Verdict.NOTHING: ("broken", "Run incomplete"),
}
_GOES_FIRST = {SCHEDULER: "other programs", AFFINITY: "another loop on its CPU"}
"""Who holds up a loop that lacks a setting."""


@dataclass(frozen=True)
class ReportHead:
    """The top of a report.

    Attributes:
        level: ``good``, ``bad`` (bounds not kept), ``mixed`` (kept by some laws only) or ``broken``
            (no run to judge as a whole).
        headline: the verdict.
        reasons: what it rests on, a sentence each.
        faults: what went wrong, causes before what followed from them.
    """

    level: Level
    headline: str
    reasons: Sequence[str]
    faults: Sequence[str] = ()


def verdict_on_run(
    run: RunData,
    summary: dict[str, Any],
    conditions: Mapping[str, str] = MappingProxyType({}),
) -> ReportHead:
    """The verdict on a run, which came about under some conditions, where they are known."""
    bounds, known = summary["bounds"], known_ticks(run)
    reasons = [
        _bounds_sentence(run, bounds, known),
        *_shortcomings(run, summary, known),
        *_sentences_on_a_stall(summary["timing"]["longest_stall_ms"], conditions),
    ]
    level, headline = _HEADLINES[verdict_of(summary)]
    if summary["recording"]["damage"]:
        headline = f"Recording damaged: {headline[0].lower()}{headline[1:]}"
    if level == "broken" and bounds["violation_fraction"]:
        headline += ", bounds not kept"
    elif level == "broken" and bounds["violation_fraction"] is not None:
        headline += ", inside its bounds where it is known"
    return ReportHead(level, headline, reasons, summary["faults"])


def damaged(damage: Sequence[str]) -> str:
    """What to say of a damaged recording."""
    return f"The recording is damaged: {'; '.join(damage)}."


def _shortcomings(run: RunData, summary: dict[str, Any], known: KnownTicks) -> list[str]:
    """Everything but faults that makes this less than a whole run on an undisturbed machine."""
    found = []
    if summary["recording"]["damage"]:
        found.append(damaged(summary["recording"]["damage"]))
    elif not run.complete:
        found.append(PARTIAL)
    if (found or known.missing) and (counted := plant_count(run).get("outside")):
        found.append(f"The plant itself counted {counted:,} ticks outside its bounds.")
    if known.missing:
        found += [missing_ticks_sentence(known), *_sentences_on_gaps(summary)]
    if run.lacks_checksums:
        found.append(UNCHECKED)
    found.extend(f"{note}." for note in run.notes)
    planned_s, timing = run.setup.scenario.duration_s, summary["timing"]
    if not summary["completed"] and summary["duration_s"] < planned_s:
        found.append(f"The data end at {summary['duration_s']:.3f} s of {planned_s:g} s planned.")
    if run.lost:
        missed = ", ".join(f"{topic} {count:,}" for topic, count in run.lost.items())
        found.append(f"The recording lacks {sum(run.lost.values()):,} messages: {missed}.")
    if timing["deadline_misses"] and timing["stolen_ms"]:
        found.append(
            f"A hypervisor took {timing['stolen_ms']:.0f} ms of CPU time away during the run."
        )
    return found


def _sentences_on_a_stall(stall_ms: float | None, conditions: Mapping[str, str]) -> list[str]:
    """That a loop was held up for long, and by whom most likely, as far as that can be told."""
    if stall_ms is None or stall_ms <= STALL_MS:
        return []
    is_known, lacked = granted_and_not(conditions)
    if lacked:
        who = " or ".join(_GOES_FIRST[name] for name in lacked)
        cause = f"most likely by {who}, as a loop of this run had no {' and no '.join(lacked)}"
    else:
        cause = "most likely by the host" if is_known else "by the host or by other processes"
    said = f"A loop was held up for {stall_ms:.0f} ms, {cause}"
    return [f"{said}: what came of it says little of the law."]


def _sentences_on_gaps(summary: dict[str, Any]) -> list[str]:
    """What missing ticks mean for numbers that rest on neighbouring ones."""
    recording = summary["recording"]
    left_out_s = recording["torque_left_out_s"]
    pairs = zip(summary["tracking"]["joint_names"], recording["settling_is_latest"], strict=True)
    names = ", ".join(name for name, is_latest in pairs if is_latest)
    found = []
    if names:
        found.append(f"Settled while ticks are missing, at the time given at the latest: {names}.")
    if left_out_s:
        found.append(
            f"Variation and spectrum of the torques leave out the {left_out_s:.3f} s over them."
        )
    return found


def missing_ticks_sentence(known: KnownTicks) -> str:
    """What to say of ticks that are not in a recording."""
    return (
        f"The true motion is known at {known.known:,} of {known.ticks:,} ticks: missing are those"
        f" at {known.gaps_text}."
    )


def times_text(bounds: Mapping[str, Any]) -> str:
    """How far outside its bounds an error was; a state that is no number has no such figure."""
    margin = bounds["margin_min"]
    return "an unknown multiple of" if margin is None else f"{number(1.0 - margin)} times"


def _bounds_sentence(run: RunData, bounds: dict[str, Any], known: KnownTicks) -> str:
    if bounds["violation_fraction"] is None:
        return "No tick was recorded, so there is nothing to judge."
    is_all = not known.missing and not run.damage
    of_all = f" of {known.ticks:,}" if known.missing else ""
    where = f"the {known.known:,}{of_all} ticks at which it is known"
    if not bounds["violation_fraction"]:
        return (
            "The true error of every joint was inside its bounds at"
            f" {f'all {known.ticks:,} ticks' if is_all else where}; the smallest margin was"
            f" {margin_text(bounds['margin_min'])}."
        )
    return (
        f"The true error was outside its bounds at {number(bounds['violation_fraction'], 100)} %"
        f" of {'the ticks' if is_all else where}, for the first time at"
        f" {bounds['first_violation_s']:.3f} s, and at most {times_text(bounds)} its bound."
    )

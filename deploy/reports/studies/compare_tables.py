"""The numbers of a comparison: the verdict in words, and tables with a row for each law."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

from deploy.comparison.comparison import Comparison, LawRun
from deploy.reports import quantities
from deploy.reports.tables import (
    Cell,
    Column,
    Table,
    Value,
    margin_text,
    number,
    scaled,
    short_names,
)
from deploy.reports.verdict import ReportHead, damaged, missing_ticks_sentence, times_text
from deploy.runs.judging.known_ticks import known_ticks
from deploy.runs.judging.verdict import Verdict

_SHOWN_FAULTS = 2
_NAMED_JOINTS = 2


def _percentage(section: str, key: str) -> Callable[[dict[str, Any]], float | None]:
    return lambda summary: scaled(summary[section][key], 100.0)


def _margin(summary: dict[str, Any]) -> Value:
    """With its unit: it is per cent, or a multiple of the bound where that was left far behind."""
    return margin_text(summary["bounds"]["margin_min"])


_NUMBERS: list[tuple[Column, Callable[[dict[str, Any]], Value], bool]] = [
    (Column("Ticks outside", "%", "Outside"), _percentage("bounds", "violation_fraction"), False),
    (Column("Smallest margin", "", "Margin"), _margin, False),
    (replace(quantities.RMS_ERROR.column, brief=None), quantities.RMS_ERROR.of_worst_joint, True),
    (quantities.TOTAL_VARIATION.column, quantities.TOTAL_VARIATION.of_worst_joint, True),
    (quantities.SHARE_ABOVE_50_HZ.column, quantities.SHARE_ABOVE_50_HZ.of_worst_joint, True),
    (quantities.SETTLING_TIME.column, quantities.SETTLING_TIME.of_worst_joint, True),
    (quantities.SETTLING_BOUND.column, quantities.SETTLING_BOUND.of_worst_joint, False),
    (Column("Saturated ticks", "%", None), _percentage("torque", "saturated_fraction"), False),
]
"""Columns of the verdict, what stands in them, and whether the smallest is the best."""


def verdict_on_laws(comparison: Comparison) -> ReportHead:
    """The verdict on a comparison."""
    runs = comparison.runs
    kept = [run for run in runs if run.kept_bounds]
    unsound = [run for run in runs if run.verdict not in (Verdict.KEPT, Verdict.LOST)]
    reasons = [f"{run.law}: {bounds_sentence(run)}" for run in runs]
    reasons += [*recording_sentences(runs), *_ranking(comparison)]
    headline = f"{len(kept)} of {len(runs)} laws kept their bounds"
    if unsound:
        unread = " or cannot be read whole" if Verdict.UNKNOWN in {r.verdict for r in runs} else ""
        return ReportHead("broken", f"{headline}, {len(unsound)} did not finish{unread}", reasons)
    if len(kept) == len(runs):
        return ReportHead("good", f"All {len(runs)} laws kept their bounds", reasons)
    if not kept:
        return ReportHead("bad", "No law kept its bounds", reasons)
    return ReportHead("mixed", headline, reasons)


def bounds_sentence(run: LawRun) -> str:
    """What became of a law's bounds, or of the law."""
    faults = run.summary["faults"]
    if faults:
        return "; ".join(faults[:_SHOWN_FAULTS])
    if run.verdict is Verdict.INTERRUPTED:
        return "did not come to its end"
    is_known = run.verdict is not Verdict.UNKNOWN
    return f"{'' if is_known else 'not all of it is known; where it is, it '}{_bounds_text(run)}"


def recording_sentences(runs: Iterable[LawRun]) -> list[str]:
    """What the recordings of runs lack, each with its law, as far as they lack anything."""
    found = []
    for run in runs:
        if damage := run.summary["recording"]["damage"]:
            found.append(f"{run.law}: {damaged(damage)}")
        if (known := known_ticks(run.data)).missing:
            found.append(f"{run.law}: {missing_ticks_sentence(known)}")
    return found


def _bounds_text(run: LawRun) -> str:
    bounds = run.summary["bounds"]
    if bounds["violation_fraction"] is None:
        return "has no tick"
    if not bounds["violation_fraction"]:
        if run.verdict is Verdict.LOST:
            return "left its bounds at ticks that its recording lacks, as the plant counted"
        inside = "kept" if run.kept_bounds else "was inside"
        return f"{inside} its bounds, smallest margin {margin_text(bounds['margin_min'])}"
    return (
        f"left its bounds at {bounds['first_violation_s']:.3f} s, outside at"
        f" {number(bounds['violation_fraction'], 100.0, ' %')} of the ticks, at most"
        f" {times_text(bounds)} its bound"
    )


def verdict_table(comparison: Comparison) -> Table:
    """A row per law with what decides; each number is that of the law's worst joint."""
    scenario = comparison.runs[0].data.setup.scenario
    rows = [
        [Cell(run.law), status_cell(run), *(Cell(value(run.summary)) for _, value, _ in _NUMBERS)]
        for run in comparison.runs
    ]
    ranked = (place for place, (*_, is_ranked) in enumerate(_NUMBERS, start=2) if is_ranked)
    _mark_best(comparison, rows, ranked)
    return Table(
        f"{scenario.name} · {scenario.duration_s:g} s · worst joint of each law",
        [
            Column("Law", is_text=True),
            Column("Bounds", is_text=True),
            *(column for column, _, _ in _NUMBERS),
        ],
        rows,
        "The best of all laws that kept their bounds is set off. RMS errors from"
        f" {scenario.metrics.from_s:g} s on; everything else over the whole run."
        f" {quantities.SETTLED}",
    )


def joint_table(comparison: Comparison, quantity: quantities.JointQuantity) -> Table:
    """One number of every joint, a row per law, the smallest of each joint set off."""
    tracking = comparison.runs[0].summary["tracking"]
    from_s = comparison.runs[0].data.setup.scenario.metrics.from_s
    rows = [[Cell(run.law), *map(Cell, quantity.of_joints(run.summary))] for run in comparison.runs]
    names = tracking["joint_names"]
    _mark_best(comparison, rows, range(1, len(names) + 1))
    columns = [
        Column(name, brief=brief) for name, brief in zip(names, short_names(names), strict=True)
    ]
    return Table(
        f"{quantity.heading}{f' from {from_s:g} s on' if quantity.late else ''} ({quantity.unit})",
        [Column("Law", is_text=True), *columns],
        rows,
    )


def status_cell(run: LawRun) -> Cell:
    """The verdict on a run, as a cell."""
    return Cell(run.verdict.value, "good" if run.kept_bounds else "bad")


def _mark_best(comparison: Comparison, rows: list[list[Cell]], columns: Iterable[int]) -> None:
    """Set off the smallest number of each column, where several laws kept their bounds.

    What a law does that left its funnel is no standard for others, however smooth it is.
    """
    kept = [row for row, run in zip(rows, comparison.runs, strict=True) if run.kept_bounds]
    for column in columns:
        values = [row[column].value for row in kept]
        known = [value for value in values if isinstance(value, float)]
        if len(known) > 1:
            best = kept[values.index(min(known))]
            best[column] = Cell(best[column].value, "best")


def _ranking(comparison: Comparison) -> list[str]:
    """Who of those that kept their bounds is most precise, joint by joint, and who smoothest."""
    kept = [run for run in comparison.runs if run.kept_bounds]
    sentences = []
    for what, section, key in (
        ("Smallest RMS error", "tracking", "rms_rad"),
        ("Least total variation of torque", "torque", "total_variation_nm_per_s"),
    ):
        competing = {run.law: run.summary[section][key] for run in kept}
        competing = {law: values for law, values in competing.items() if values is not None}
        if len(competing) > 1:
            sentences.append(f"{what}: {_winners(competing, kept)}.")
    return sentences


def _winners(competing: dict[str, list[float]], kept: list[LawRun]) -> str:
    """Who has the smallest number on which joints, and how much less than the next best."""
    names = kept[0].summary["tracking"]["joint_names"]
    won: dict[str, dict[str, float]] = {}
    for joint, name in enumerate(names):
        first, second = sorted(competing, key=lambda law: competing[law][joint])[:2]
        ratio = competing[first][joint] / max(competing[second][joint], 1e-300)
        won.setdefault(first, {})[name] = ratio
    return "; ".join(
        f"{law} on {_joints(list(ratios), len(names))},"
        f" at most {number(max(ratios.values()))} × the next best"
        for law, ratios in won.items()
    )


def _joints(some: list[str], joints: int) -> str:
    if len(some) == joints:
        return "every joint"
    if len(some) <= _NAMED_JOINTS:
        return " and ".join(some)
    return f"{len(some)} of {joints} joints"

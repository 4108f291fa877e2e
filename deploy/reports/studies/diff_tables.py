"""Recorded runs side by side as tables: a column for each run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from bus_schema.configuration import shortened
from bus_schema.percentiles import PERCENTILES
from deploy.comparison.comparison import LawRun
from deploy.comparison.recorded import Parting, RecordedRuns
from deploy.reports import quantities
from deploy.reports.studies.compare_tables import bounds_sentence, recording_sentences, status_cell
from deploy.reports.tables import (
    ABSENT,
    Cell,
    Column,
    Table,
    Value,
    margin_percent,
    number,
    percent,
    scaled,
)
from deploy.reports.verdict import ReportHead
from deploy.runs.conditions import conditions_of_runs
from deploy.runs.judging.bounds import bound_usage
from deploy.runs.judging.known_ticks import known_ticks
from deploy.runs.judging.verdict import Verdict

_MRAD = 1e3
_LONGEST_VALUE = 60
_PERCENTILES = {name: name.replace("_", ".") for name in PERCENTILES}


def verdict_on_runs(compared: RecordedRuns) -> ReportHead:
    """What is the same and what is not, in words."""
    runs, keys = compared.runs, len(compared.differing)
    unsound = [run for run in runs if run.verdict not in (Verdict.KEPT, Verdict.LOST)]
    reasons = [f"{run.law}: {bounds_sentence(run)}" for run in runs]
    has_gaps = any(known_ticks(run.data).missing for run in runs)
    every = "every tick that is known of both" if has_gaps else "every tick"
    reasons += [
        f"{label}: {_parting_text(parting, compared.labels[0], every)}"
        for label, parting in zip(compared.labels[1:], compared.partings[1:], strict=True)
    ]
    reasons += [f"{label}: {text}" for label, text in compared.differences_of_arithmetic.items()]
    reasons += recording_sentences(runs)
    differ = "value differs" if keys == 1 else "values differ"
    reasons.append(f"{keys or 'No'} {differ} between the scenarios.")
    kept = sum(run.kept_bounds for run in runs)
    headline = f"{kept} of {len(runs)} runs kept their bounds; they are {_same(compared, every)}"
    if unsound:
        return ReportHead(
            "broken", f"{headline}, {len(unsound)} did not finish or cannot be read whole", reasons
        )
    if kept == len(runs):
        return ReportHead("good", headline, reasons)
    return ReportHead("mixed" if kept else "bad", headline, reasons)


def run_tables(compared: RecordedRuns) -> list[Table]:
    """What the runs were and what became of them; what differs in their scenarios, if anything."""
    return [run_table(compared), *([difference_table(compared)] if compared.differing else [])]


def joint_tables(compared: RecordedRuns) -> list[Table]:
    """Numbers of every joint."""
    shown = (quantities.RMS_ERROR, None, quantities.TOTAL_VARIATION)
    return [joint_table(compared, quantity) for quantity in shown]


def run_table(compared: RecordedRuns) -> Table:
    """What each run was, and what became of it."""
    runs = compared.runs
    conditions = [
        conditions_of_runs([run.data.setup], manifest)
        for run, manifest in zip(runs, compared.manifests, strict=True)
    ]
    rows: list[list[Cell | Value]] = [
        [title, *(run.summary[key] for run in runs)]
        for title, key in (("Scenario", "scenario"), ("Law", "law"), ("Link", "link"))
    ]
    rows += [["Clock", *(_CLOCKS.get(run.data.clock, run.data.clock) for run in runs)]]
    rows += [
        [name.capitalize(), *(each[name] for each in conditions)] for name in ("version", "date")
    ]
    rows += [["Duration (s)", *(run.summary["duration_s"] for run in runs)]]
    rows += [["Bounds", *map(status_cell, runs)]]
    rows += _by_run(runs, {
        "Smallest margin (%)": lambda s: margin_percent(s["bounds"]["margin_min"]),
        "Ticks outside (%)": lambda s: scaled(s["bounds"]["violation_fraction"], 100.0),
        "First outside (s)": lambda s: s["bounds"]["first_violation_s"],
        "Faults": lambda s: len(s["faults"]),
        "Deadlines met": lambda s: percent(s["timing"]["success_rate"]),
        "Deadlines missed": lambda s: s["timing"]["deadline_misses"],
        "Real-time factor": lambda s: s["real_time_factor"],
        "Messages lost by the recorder": lambda s: s["recorder"]["lost"],
        "Commands lost": lambda s: s["transport"]["downlink"]["lost"],
        "Digest": lambda s: s["digest"][:12],
    })  # fmt: skip
    digests = [run.summary["digest"] for run in runs]
    same = (Cell("same", "good") if each == digests[0] else "differs" for each in digests[1:])
    rows.append(["Digest, beside the first", ABSENT, *same])
    for title, (none, value) in _PARTINGS.items():
        partings = (none if p is None else value(p) for p in compared.partings[1:])
        rows.append([title, ABSENT, *partings])
    return Table(
        "Runs", _columns(compared, "Run"), rows,
        "Ticks are compared by position, velocity and torque of every joint, bit by bit; digests,"
        " by every byte of states and commands with their stamps, so those of real time differ.",
    )  # fmt: skip


_CLOCKS = {
    "realtime": "run in real time",
    "lockstep": "run in lockstep",
    "virtual": "simulated in virtual time",
}
"""What kept time, by the name it has in recordings: what a run was, not what its scenario says."""

_PARTINGS: dict[str, tuple[Cell | Value, Callable[[Parting], Value]]] = {
    "First tick that differs": (Cell("never", "good"), lambda parting: str(parting.tick)),
    "… at (s)": (ABSENT, lambda parting: parting.time_s),
    "Positions apart, most (mrad)": (
        Cell("0", "good"), lambda parting: scaled(parting.largest_rad, _MRAD)
    ),
}  # fmt: skip
"""What is told of a run that parts from the first, after what is told of one that never does."""


def joint_table(compared: RecordedRuns, quantity: quantities.JointQuantity | None) -> Table:
    """A number of every joint, a row each; without a quantity the worst error in % of its bound."""
    names = compared.runs[0].data.setup.robot.joint_names
    by_run: list[Sequence[float | None]]
    if quantity is None:
        title, unit = "Worst error in % of its bound", ""
        by_run = [_worst_usage_percent(run) for run in compared.runs]
    else:
        title, unit = quantity.heading, f" ({quantity.unit})"
        by_run = [quantity.of_joints(run.summary) for run in compared.runs]
    rows: list[list[Cell | Value]] = [
        [name, *values, *_ratio(values)]
        for name, values in zip(names, zip(*by_run, strict=True), strict=True)
    ]
    note = "Each over its own scenario's metrics.from_s on." if quantity and quantity.late else ""
    return Table(f"{title}{unit}", _columns(compared, "Joint", ratio=True), rows, note)


def timing_table(compared: RecordedRuns) -> Table:
    """Percentiles of every time that was not zero in all runs."""
    rows: list[list[Cell | Value]] = []
    for key, name in quantities.TIMES.items():
        for percentile, title in _PERCENTILES.items():
            values = [run.summary["timing"][key][percentile] for run in compared.runs]
            if any(values):
                rows.append([f"{name}, {title}", *values, *_ratio(values)])
    return Table(
        "Timing (µs)", _columns(compared, "Time", ratio=True), rows,
        "Control step and wake-up lateness are wall time, the others are on each run's clock.",
    )  # fmt: skip


def difference_table(compared: RecordedRuns) -> Table:
    """Values of the scenarios that are not the same in all runs."""
    rows = [
        [key, *(ABSENT if value is None else shortened(value, _LONGEST_VALUE) for value in values)]
        for key, values in compared.differing.items()
    ]
    columns = [Column(label, is_text=True) for label in ("Key", *compared.labels)]
    return Table("What differs in the scenarios", columns, rows)


def _by_run(
    runs: Sequence[LawRun], values: dict[str, Callable[[dict[str, Any]], Value]]
) -> list[list[Cell | Value]]:
    return [[title, *(value(run.summary) for run in runs)] for title, value in values.items()]


def _columns(compared: RecordedRuns, heading: str, *, ratio: bool = False) -> list[Column]:
    columns = [Column(heading, is_text=True), *map(Column, compared.labels)]
    return [*columns, Column("Ratio")] if ratio and len(compared.runs) == 2 else columns


def _ratio(values: Sequence[float | None]) -> list[Value]:
    """The second over the first, where there are two."""
    if len(values) != 2:
        return []
    first, second = values
    return [None if not first or second is None else f"× {number(second / first)}"]


def _worst_usage_percent(run: LawRun) -> list[float | None]:
    usage = bound_usage(run.data)
    if not len(usage):
        return [None] * usage.shape[1]
    return [100.0 * float(worst) for worst in usage.max(axis=0)]


def _same(compared: RecordedRuns, every: str) -> str:
    partings = [parting for parting in compared.partings if parting is not None]
    if not partings:
        return f"the same at {every}"
    has_same_begin = all(each.is_end and each.largest_rad is not None for each in partings)
    return "the same until one ends" if has_same_begin else "not the same"


def _parting_text(parting: Parting | None, first: str, every: str) -> str:
    if parting is None:
        return f"the same as {first} at {every}, to the bit"
    if parting.largest_rad is None:
        return f"has no tick at the time of one of {first}"
    if parting.is_end:
        return f"the same as {first} at {every} before {parting.tick}, where one ends, to the bit"
    apart = number(parting.largest_rad, _MRAD, " mrad")
    return (
        f"leaves {first} at tick {parting.tick} ({number(parting.time_s)} s); positions are at most"
        f" {apart} apart"
    )

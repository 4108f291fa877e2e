"""The numbers of several runs as tables: of laws, and of recorded runs side by side."""

from __future__ import annotations

from collections.abc import Sequence

from bus_schema.foreign_text import shortened
from deploy.judge.bounds import bound_usage
from deploy.judge.conditions import conditions_of_runs
from deploy.reports.runs import run_numbers
from deploy.reports.runs.run_tables import PERCENTILE_NAMES, WALL_TIME, Row, number_rows
from deploy.reports.tables import ABSENT, Cell, Column, Table, Value, number, scaled
from deploy.run.execute import JudgedRun
from deploy.studies.comparison.tables import status_cell
from deploy.study.comparison.recorded import RecordedRuns

_MRAD = 1e3
_LONGEST_VALUE = 60
_CLOCKS = {
    "realtime": "run in real time",
    "lockstep": "run in lockstep",
    "virtual": "simulated in virtual time",
}
"""Words for the clock of a run, by its name in the recording."""


def recorded_table(compared: RecordedRuns) -> Table:
    """Return the table of recorded runs: settings and outcome of each."""
    runs, results = compared.runs, [run.result for run in compared.runs]
    rows: list[Row] = [
        [key.capitalize(), *(getattr(result, key) for result in results)]
        for key in ("scenario", "law", "link")
    ]
    rows += [["Clock", *(_CLOCKS.get(run.data.clock, run.data.clock) for run in runs)]]
    rows += [["Duration (s)", *(result.duration_s for result in results)]]
    rows += [["Bounds", *map(status_cell, runs)]]
    rows += number_rows(run_numbers.BOUND_NUMBERS, results)
    digest, *others = (result.digest for result in results)
    same = (Cell("same", "good") if each == digest else "differs" for each in others)
    rows.append(["Digest, compared with the first run", ABSENT, *same])
    partings = compared.partings[1:]
    ticks = (Cell("never", "good") if p is None else str(p.tick) for p in partings)
    times_s = (None if p is None else p.time_s for p in partings)
    apart = (Cell("0", "good") if p is None else scaled(p.largest_rad, _MRAD) for p in partings)
    rows.append(["First tick that differs", ABSENT, *ticks])
    rows.append(["… at (s)", ABSENT, *times_s])
    rows.append(["Largest difference of a position (mrad)", ABSENT, *apart])
    return Table(
        "Runs", _columns(compared, "Run"), rows,
        "Ticks are compared by position, velocity and torque of every joint, bit by bit. Digests"
        " cover every byte of states and commands with their stamps, so those of runs in real"
        " time differ.",
    )  # fmt: skip


def recorded_counts(compared: RecordedRuns) -> Table:
    """Version, date and counts of each recorded run."""
    conditions = [
        conditions_of_runs([run.data.setup], manifest)
        for run, manifest in zip(compared.runs, compared.manifests, strict=True)
    ]
    rows: list[Row] = [
        [key.capitalize(), *(each[key] for each in conditions)] for key in ("version", "date")
    ]
    rows += number_rows(run_numbers.RUN_COUNTS, [run.result for run in compared.runs])
    return Table("Counts", _columns(compared, "Run"), rows)


def difference_table(compared: RecordedRuns) -> Table:
    """Values of the scenarios that are not the same in all runs."""
    rows = [
        [key, *(ABSENT if value is None else shortened(value, _LONGEST_VALUE) for value in values)]
        for key, values in compared.differing.items()
    ]
    columns = [Column(label, is_text=True) for label in ("Key", *compared.labels)]
    return Table("Differences of the scenarios", columns, rows)


def recorded_joint_tables(compared: RecordedRuns) -> list[Table]:
    """RMS error, worst share of the bound and travel of torque, a row for each joint."""
    runs, rms, travel = compared.runs, run_numbers.RMS_ERROR, run_numbers.TOTAL_VARIATION
    usage = [_worst_usage(run) for run in runs]
    each_from = "Each run from its own scenario's metrics.from_s on."
    return [
        _joints(compared, rms.column, [rms.of_joints(run.result) for run in runs], each_from),
        _joints(compared, Column("Worst error in % of its bound"), usage),
        _joints(compared, travel.column, [travel.of_joints(run.result) for run in runs]),
    ]


def _joints(
    compared: RecordedRuns, column: Column, by_run: list[list[float | None]], note: str = ""
) -> Table:
    """A number of every joint, shape (runs, joints)."""
    names = compared.runs[0].data.setup.robot.joint_names
    rows = [[name, *row, *_ratio(row)] for name, *row in zip(names, *by_run, strict=True)]
    return Table(column.title, _columns(compared, "Joint", ratio=True), rows, note)


def recorded_timing_table(compared: RecordedRuns) -> Table:
    """Percentiles of every time that was not zero in all runs."""
    rows: list[Row] = []
    for key, name in run_numbers.TIMES.items():
        for percentile, title in PERCENTILE_NAMES.items():
            values = [getattr(run.result.timing, key)[percentile] for run in compared.runs]
            if any(values):
                rows.append([f"{name}, {title}", *values, *_ratio(values)])
    return Table("Timing (µs)", _columns(compared, "Time", ratio=True), rows, WALL_TIME)


def _columns(compared: RecordedRuns, heading: str, *, ratio: bool = False) -> list[Column]:
    columns = [Column(heading, is_text=True), *map(Column, compared.labels)]
    return [*columns, Column("Ratio")] if ratio and len(compared.runs) == 2 else columns


def _ratio(values: Sequence[float | None]) -> list[Value]:
    """The second over the first, where there are two."""
    if len(values) != 2:
        return []
    first, second = values
    return [None if not first or second is None else f"× {number(second / first)}"]


def _worst_usage(run: JudgedRun) -> list[float | None]:
    usage = bound_usage(run.data)
    if not len(usage):
        return [None] * usage.shape[1]
    return [100.0 * float(worst) for worst in usage.max(axis=0)]

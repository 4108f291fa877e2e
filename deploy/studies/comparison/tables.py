"""Tables of a comparison: a row for each law."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from deploy.reports.runs import run_numbers
from deploy.reports.runs.run_numbers import JointQuantity
from deploy.reports.tables import Cell, Column, Table, short_names
from deploy.run.execute import JudgedRun
from deploy.study.comparison.compared_runs import ComparedRuns


def verdict_table(comparison: ComparedRuns) -> Table:
    """A row per law with what decides; each number is that of the law's worst joint."""
    scenario = comparison.runs[0].data.setup.scenario
    shown = run_numbers.OF_LAWS
    rows = [
        [Cell(run.law), status_cell(run), *(Cell(of(run.result)) for _, of, _ in shown)]
        for run in comparison.runs
    ]
    ranked = (place for place, (*_, is_ranked) in enumerate(shown, start=2) if is_ranked)
    _mark_best(comparison.runs, rows, ranked)
    names = (Column(heading, is_text=True) for heading in ("Law", "Bounds"))
    return Table(
        f"{scenario.name} · {scenario.duration_s:g} s · worst joint of each law",
        [*names, *(column for column, _, _ in shown)],
        rows,
        "The best value of all laws that kept their bounds is highlighted. RMS errors and steady"
        f" margins from {scenario.metrics.from_s:g} s on; everything else over the whole run."
        f" {run_numbers.SETTLED}",
    )


def law_table(comparison: ComparedRuns, quantity: JointQuantity) -> Table:
    """One number of every joint, a row per law, the smallest of each joint set off."""
    runs = comparison.runs
    names = runs[0].result.tracking.joint_names
    from_s = runs[0].data.setup.scenario.metrics.from_s
    rows = [[Cell(run.law), *map(Cell, quantity.of_joints(run.result))] for run in runs]
    _mark_best(runs, rows, range(1, len(names) + 1))
    briefs = short_names(names)
    columns = [Column(name, brief=brief) for name, brief in zip(names, briefs, strict=True)]
    return Table(
        f"{quantity.heading}{f' from {from_s:g} s on' if quantity.late else ''} ({quantity.unit})",
        [Column("Law", is_text=True), *columns],
        rows,
        most_printed=None if quantity is run_numbers.RMS_ERROR else 0,
    )


def status_cell(run: JudgedRun) -> Cell:
    """The verdict on a run, as a cell."""
    return Cell(run.verdict.value, "good" if run.kept_bounds else "bad")


def _mark_best(runs: Sequence[JudgedRun], rows: list[list[Cell]], columns: Iterable[int]) -> None:
    """Set off the smallest number of each column, where several laws kept their bounds.

    What a law does that left its funnel is no standard for others, however smooth it is.
    """
    kept = [row for row, run in zip(rows, runs, strict=True) if run.kept_bounds]
    for column in columns:
        values = [row[column].value for row in kept]
        known = [value for value in values if isinstance(value, float)]
        if len(known) > 1:
            best = kept[values.index(min(known))]
            best[column] = Cell(best[column].value, "best")

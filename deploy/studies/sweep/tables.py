"""Tables of sweeps."""

from __future__ import annotations

from collections.abc import Callable

from deploy.reports.studies.study_tables import TableColumn
from deploy.reports.studies.study_texts import interval_text, share_text
from deploy.reports.tables import Column, Table, Value, scaled, table_of
from deploy.studies.sweep.result import Axis, Point, SweepResult
from deploy.study.study import shown_value

_SHOWN_POINTS = 40


def point_table(summary: SweepResult) -> Table:
    """The points of a sweep, a row each."""

    def value_of(place: int, axis: Axis) -> TableColumn:
        keys = axis.title
        brief = keys.replace(", ", "\n").replace(".", ".\n")
        return Column(keys, brief=brief), lambda point: shown_value(point.values[place])

    def spread(key: str, which: str, factor: float) -> Callable[[Point], Value]:
        return lambda point: scaled(getattr(getattr(point, key), which, None), factor)

    plants: list[TableColumn] = [
        (Column("Plants kept", brief="Plants\nkept"), share_text),
        (Column("Wilson's 95 % interval"), interval_text),
    ]
    failed: TableColumn = Column("Failed runs", brief="Failed"), lambda point: point.runs_failed
    return table_of(
        f"{summary.name} · {summary.scenario}",
        [
            (Column("Point", brief=None, is_text=True), lambda point: point.point),
            *(value_of(place, axis) for place, axis in enumerate(summary.axes)),
            *(plants if summary.plants is not None else ()),
            (Column("Runs that kept their bounds", brief="Bounds\nkept"),
             lambda point: f"{point.runs_kept} of {point.runs}"),
            (Column("Smallest margin of all runs", "%", "Bound\nleft"),
             spread("margin_min", "lowest", 100.0)),
            (Column("Ticks outside", "%", "Outside"), spread("violation_fraction", "mean", 100.0)),
            (Column("Ticks outside in the worst run", "%", None),
             spread("violation_fraction", "highest", 100.0)),
            (Column("RMS error of the worst joint", "mrad", "Worst\nRMS"),
             spread("worst_rms_rad", "mean", 1e3)),
            *([failed] if any(point.runs_failed for point in summary.points) else []),
        ],
        summary.points,
        "Means over the seeds and plants of a point; the worst run is the one with the most ticks"
        " outside.",
        _SHOWN_POINTS,
    )  # fmt: skip

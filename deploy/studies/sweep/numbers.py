"""The numbers of a sweep that a gate reads."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

from pydantic import Field

from deploy.judge.gate import Finite, Gauged
from deploy.reports.gauges import GaugedSummary, Part, of_bound
from deploy.study.study import shown_value


class _Axis(Part):
    keys: list[str]


class _Lowest(Part):
    lowest: Finite | None


class _Point(Part):
    values: list[Any]
    runs: int
    runs_kept: int
    margin_min: _Lowest


class GaugedSweep(GaugedSummary):
    """A sweep: the smallest margin of each point."""

    group = "sweep"
    axes: list[_Axis]
    points: Annotated[list[_Point], Field(min_length=1)]

    def numbers(self) -> Iterator[Gauged]:
        for point in self.points:
            if len(point.values) != len(self.axes):
                raise ValueError("points: values: must be one for each of axes")
            values = zip(self.axes, point.values, strict=True)
            name = ", ".join(f"{', '.join(axis.keys)} = {shown_value(v)}" for axis, v in values)
            is_kept = point.runs_kept == point.runs
            yield of_bound(name, point.margin_min.lowest if is_kept else None)

"""The result of a sweep, as ``summary.json`` has it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from pydantic import Field

from deploy.judge.gate import Gauged
from deploy.reports.gauges import Part, of_bound
from deploy.reports.studies.study_result import Runs, StudyResult
from deploy.study.study import shown_value


class Axis(Part):
    """Keys that take each of some values together."""

    keys: list[str]
    values: list[Any] = Field(default=[])

    @property
    def title(self) -> str:
        """The keys as text."""
        return ", ".join(self.keys)


class Point(Runs):
    """A point of the grid: its value on each axis, and its runs."""

    point: str = ""
    values: list[Any]


class SweepResult(StudyResult):
    """A sweep: the smallest margin of each point.

    Attributes:
        without_effect: keys whose values changed no result.
    """

    group = "sweep"
    scenario: str = ""
    plants: int | None = None
    without_effect: list[str] = Field(default=[])
    axes: list[Axis]
    points: list[Point]

    def numbers(self) -> Iterator[Gauged]:
        if not self.points:
            raise ValueError("points: must be one or more")
        for point in self.points:
            if len(point.values) != len(self.axes):
                raise ValueError("points: values: must be one for each of axes")
            if point.margin_min is None:
                raise ValueError("points: margin_min: is missing")
            name = ", ".join(self.named(range(len(self.axes)), point.values))
            is_kept = point.runs_kept == point.runs
            yield of_bound(name, point.margin_min.lowest if is_kept else None)

    def named(self, axes: Iterable[int], values: Iterable[Any]) -> list[str]:
        """Return values on some axes, each with its keys."""
        pairs = zip(axes, values, strict=True)
        return [f"{self.axes[axis].title} = {shown_value(value)}" for axis, value in pairs]

"""The numbers of data sheets that a gate reads."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from deploy.judge.gate import Finite, Gauged
from deploy.reports.gauges import MM, GaugedSummary, Part
from deploy.studies.margin.result import MarginResult
from deploy.studies.robustness.result import RobustnessResult


class _Parts(Part):
    margin: MarginResult
    plants: RobustnessResult | None = None


class DataSheetResult(GaugedSummary):
    """A data sheet: its margin with compensation, and that of its uncertain plants."""

    group = "datasheet"
    parts: _Parts

    def numbers(self) -> Iterator[Gauged]:
        margin = self.parts.margin
        cases = [case for case in margin.cases if case.compensation]
        yield from margin.model_copy(update={"cases": cases}).numbers()
        if self.parts.plants is not None:
            for each in self.parts.plants.numbers():
                yield replace(each, name=f"{each.name}, uncertain plants")


class _Way(Part):
    way: str
    runs: int
    kept: int
    tip_largest_mm: Finite | None


class RobotSheetResult(GaugedSummary):
    """A robot's data sheet: its margins, and the largest error of its tip in each way."""

    group = "robot_datasheet"
    other_units = (MM,)
    arm: str
    margin: MarginResult
    ways: list[_Way]

    def numbers(self) -> Iterator[Gauged]:
        yield from self.margin.numbers()
        for way in self.ways:
            largest = way.tip_largest_mm if way.kept == way.runs else None
            yield Gauged(f"{self.arm}, {way.way}, largest tip error", largest, MM, sign=-1)

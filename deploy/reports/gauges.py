"""The numbers in a summary that a gate reads, by kind of result."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field

from deploy.judge.gate import Finite, Gauged
from deploy.judge.verdict import Verdict
from deploy.reports.studies.study_texts import case_title
from deploy.study.study import OF_BOUND, shown_value

_EVERY_PATTERN = ", every pattern of delays"
_RUNS, _MM, _MS, _JERK = "runs", "mm", "ms", "rad/s3"


class _Part(BaseModel):
    """A part of a ``summary.json``; it may have more keys."""

    model_config = ConfigDict(strict=True, allow_inf_nan=False, extra="allow")


class GaugedSummary(_Part, ABC):
    """The part of a summary that a gate reads.

    Attributes:
        group: name of the results that can be compared with these.
        other_units: of numbers that a gate reads only if its limit has this unit.
        completed: whether the results are complete.
        tested_with: the test behind the results; None if an older version made them.
    """

    group: ClassVar[str] = _RUNS
    other_units: ClassVar[tuple[str, ...]] = ()
    completed: bool = True
    tested_with: dict[str, dict[str, Any]] | None = None

    @abstractmethod
    def numbers(self) -> Iterator[Gauged]:
        """Return the numbers; raises `ValueError` if one is missing."""

    @property
    def compared_as(self) -> str:
        """Quantity by which these results can be compared, as by `compared_with`."""
        return self.group

    @classmethod
    def compared_with(cls, quantity: str | None, *, patterns: bool) -> str:
        """Return what can be compared: results of one group, and margins of one quantity.

        Args:
            quantity: quantity of the margins, if there are any.
            patterns: whether they are for every pattern of delays.
        """
        if quantity:
            return f"{cls.group} of {quantity}{_EVERY_PATTERN if patterns else ''}"
        return cls.group


class _Bounds(_Part):
    margin_min: Finite | None


class _TipError(_Part):
    largest: Finite | None


class _Chunks(_Part):
    jump_mm: Finite | None = None
    jerk_rad_s3: Finite | None = None


class GaugedRun(GaugedSummary):
    """A run: its smallest margin, the largest error of its tip, and its largest lag.

    A run of a law slower than its loop also has the largest jump and jerk of its targets.
    """

    other_units = (_MM, _MS, _JERK)
    scenario: str
    law: str
    verdict: str
    bounds: _Bounds
    tip_error_mm: _TipError | None = None
    lag_ms: list[Finite | None] | None = None
    chunks: _Chunks | None = None

    def numbers(self) -> Iterator[Gauged]:
        is_kept = self.verdict == Verdict.KEPT
        name = f"{self.scenario}, {self.law}"
        yield _of_bound(name, self.bounds.margin_min if is_kept else None)
        if self.tip_error_mm is not None:  # which older versions lack
            largest = self.tip_error_mm.largest if is_kept else None
            yield Gauged(f"{name}, largest tip error", largest, _MM, sign=-1)
        if self.lag_ms is not None:
            lags = [abs(lag) for lag in self.lag_ms if lag is not None and is_kept]
            yield Gauged(f"{name}, largest lag", max(lags, default=None), _MS, sign=-1)
        if self.chunks is not None:
            of_targets = (
                ("jump", self.chunks.jump_mm, _MM),
                ("jerk", self.chunks.jerk_rad_s3, _JERK),
            )
            for what, size, unit in of_targets:
                if size is not None:
                    largest = size if is_kept else None
                    yield Gauged(f"{name}, largest {what} of targets", largest, unit, sign=-1)


class GaugedComparison(GaugedSummary):
    """A comparison: of each law what a run has."""

    other_units = GaugedRun.other_units
    laws: Annotated[dict[str, GaugedRun], Field(min_length=1)]

    def numbers(self) -> Iterator[Gauged]:
        for run in self.laws.values():
            yield from run.numbers()


class _Axis(_Part):
    keys: list[str]


class _Lowest(_Part):
    lowest: Finite | None


class _Point(_Part):
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
            yield _of_bound(name, point.margin_min.lowest if is_kept else None)


class _Worst(_Part):
    margin: Finite


class _Case(_Part):
    arm: str
    law: str
    compensation: bool | None
    drive_feedback: bool | None
    running: bool
    growth: Finite = 1
    margin: Finite | None = None
    quoted: Finite | None = None
    kept_up_to: Finite | None = None
    guaranteed: Finite | None = None
    worst_pattern: _Worst | None = None
    doubts: list[str] = []

    @property
    def covers_patterns(self) -> bool:
        """Whether delays that vary were tried too."""
        return "guaranteed" in self.model_fields_set

    @property
    def least_margin(self) -> float | None:
        """The margin to quote; of older results that for all patterns, or the one held."""
        if "quoted" in self.model_fields_set:
            return self.quoted
        found = self.margin if self.worst_pattern is None else self.worst_pattern.margin
        return found if self.guaranteed is None else self.guaranteed


class _GaugedCases(GaugedSummary):
    """Cases with a number each.

    Attributes:
        key: key of the number in the cases of a summary.
    """

    key: ClassVar[str]
    quantity: str = "delay"
    unit: str | None
    cases: Annotated[list[_Case], Field(min_length=1)]

    def numbers(self) -> Iterator[Gauged]:
        for case in self.cases:
            if self.key not in case.model_fields_set:
                raise ValueError(f"cases: {case.arm}: {self.key} is missing")
            sign = 1 if case.growth > 0 else -1
            name, doubt = case_title(case.model_dump()), "; ".join(case.doubts)
            name += _EVERY_PATTERN if case.covers_patterns else ""
            yield Gauged(name, self.value(case), self.unit or "", sign, doubt)

    @abstractmethod
    def value(self, case: _Case) -> float | None:
        """Return the number of a case."""

    @property
    def compared_as(self) -> str:
        has_patterns = any(case.covers_patterns for case in self.cases)
        return self.compared_with(self.quantity, patterns=has_patterns)


class GaugedMargins(_GaugedCases):
    """Margins of one arm."""

    group = "margin"
    key = "margin"

    def value(self, case: _Case) -> float | None:
        return case.least_margin


class GaugedRobustness(_GaugedCases):
    """Margins over uncertain plants."""

    group = "robustness"
    key = "kept_up_to"

    def value(self, case: _Case) -> float | None:
        return case.kept_up_to


class _Parts(_Part):
    margin: GaugedMargins
    plants: GaugedRobustness | None = None


class GaugedDataSheet(GaugedSummary):
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


class _Way(_Part):
    way: str
    runs: int
    kept: int
    tip_largest_mm: Finite | None


class GaugedRobotSheet(GaugedSummary):
    """A robot's data sheet: its margins, and the largest error of its tip in each way."""

    group = "robot_datasheet"
    other_units = (_MM,)
    arm: str
    margin: GaugedMargins
    ways: list[_Way]

    def numbers(self) -> Iterator[Gauged]:
        yield from self.margin.numbers()
        for way in self.ways:
            largest = way.tip_largest_mm if way.kept == way.runs else None
            yield Gauged(f"{self.arm}, {way.way}, largest tip error", largest, _MM, sign=-1)


class GaugedTuning(GaugedSummary):
    """A tuning, whose costs are for its search alone: no numbers."""

    group = "tune"

    def numbers(self) -> Iterator[Gauged]:
        return iter(())


class _Cell(_Part):
    scenario: str
    law: str
    predictor: str
    gains: str
    any_pattern_ms: Finite


class GaugedBenchmark(GaugedSummary):
    """A benchmark: the largest delay that each cell keeps in any pattern."""

    group = "benchmark"
    cells: Annotated[list[_Cell], Field(min_length=1)]

    def numbers(self) -> Iterator[Gauged]:
        for cell in self.cells:
            name = f"{cell.scenario}, {cell.law}, {cell.predictor}, {cell.gains} gains"
            yield Gauged(name, cell.any_pattern_ms, "ms")


def _of_bound(name: str, margin: float | None) -> Gauged:
    return Gauged(name, None if margin is None else 100.0 * margin, OF_BOUND)

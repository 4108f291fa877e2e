"""The numbers of cases that a gate reads."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from typing import Annotated, ClassVar

from pydantic import Field

from deploy.judge.gate import Finite, Gauged
from deploy.reports.gauges import EVERY_PATTERN, GaugedSummary, Part
from deploy.reports.studies.study_texts import case_title


class _Worst(Part):
    margin: Finite


class GaugedCase(Part):
    """A case: its names, and the numbers that its kind of study has."""

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
    doubts: list[str] = Field(default=[])

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


class GaugedCases(GaugedSummary):
    """Cases with a number each.

    Attributes:
        key: key of the number in the cases of a summary.
    """

    key: ClassVar[str]
    quantity: str = "delay"
    unit: str | None
    cases: Annotated[list[GaugedCase], Field(min_length=1)]

    def numbers(self) -> Iterator[Gauged]:
        for case in self.cases:
            if self.key not in case.model_fields_set:
                raise ValueError(f"cases: {case.arm}: {self.key} is missing")
            sign = 1 if case.growth > 0 else -1
            name, doubt = case_title(case.model_dump()), "; ".join(case.doubts)
            name += EVERY_PATTERN if case.covers_patterns else ""
            yield Gauged(name, self.value(case), self.unit or "", sign, doubt)

    @abstractmethod
    def value(self, case: GaugedCase) -> float | None:
        """Return the number of a case."""

    @property
    def compared_as(self) -> str:
        has_patterns = any(case.covers_patterns for case in self.cases)
        return self.compared_with(self.quantity, patterns=has_patterns)

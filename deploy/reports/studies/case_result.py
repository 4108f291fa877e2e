"""Results of studies of cases: a law on an arm, with or without some equipment."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from typing import Annotated, Generic, Protocol, TypeVar

from pydantic import Field

from deploy.judge.gate import Gauged
from deploy.reports.gauges import TO_QUOTE, Part
from deploy.reports.studies.study_result import Runs, StudyResult

COMPENSATION = {None: "", False: "without", True: "with"}


class Equipped(Protocol):
    """A setting with or without compensation and a drive loop; None if not asked."""

    @property
    def compensation(self) -> bool | None: ...
    @property
    def drive_feedback(self) -> bool | None: ...


class TriedValue(Runs):
    """A value of the quantity that was tried, with its runs."""

    value: float


class CaseResult(Part):
    """A case: a setting in which the quantity grows.

    Attributes:
        held_arm_ceiling_ms: how long the arm may be held at its start; None if unknown.
        model_scale: factor on the model's masses; older results have none.
        doubts: reasons why its runs do not show its margin.
    """

    arm: str
    law: str
    compensation: bool | None
    drive_feedback: bool | None
    running: bool
    held_arm_ceiling_ms: float | None = None
    model_scale: float | None = None
    doubts: list[str] = Field(default=[])

    @property
    def sign(self) -> int:
        """1 if a larger number is better, else −1."""
        return 1

    @property
    def covers_patterns(self) -> bool:
        """Whether delays that vary were tried too."""
        return False

    @property
    @abstractmethod
    def tried(self) -> list[TriedValue]:
        """The values that were tried."""

    @property
    @abstractmethod
    def number(self) -> float | None:
        """The number that a gate reads; raises `ValueError` if it is missing."""

    def require(self, key: str) -> None:
        """Check that a result has a key; raises `ValueError`."""
        if key not in self.model_fields_set:
            raise ValueError(f"cases: {self.arm}: {key} is missing")


Case = TypeVar("Case", bound=CaseResult)


class Saved(Part):
    """Runs and simulated time, against those of all variants and seeds at all tried values."""

    runs_planned: int
    runs_ended_early: int
    planned_s: float
    simulated_s: float


class CasesResult(StudyResult, Generic[Case]):
    """Cases with a number each.

    Attributes:
        quantity: what grows; `title` is its name in words.
        duration_s: duration of a run, by arm.
        saved: what was not run; older results do not say it.
    """

    quantity: str = "delay"
    title: str = ""
    unit: str | None
    duration_s: dict[str, float] = Field(default={})
    saved: Saved | None = None
    cases: Annotated[list[Case], Field(min_length=1)]

    def numbers(self) -> Iterator[Gauged]:
        for case in self.cases:
            name = case_title(case) + (TO_QUOTE if case.covers_patterns else "")
            yield Gauged(name, case.number, self.unit or "", case.sign, "; ".join(case.doubts))

    @property
    def compared_as(self) -> str:
        has_patterns = any(case.covers_patterns for case in self.cases)
        return self.compared_with(self.quantity, patterns=has_patterns)


def setting_text(case: CaseResult) -> str:
    """With what a law has a margin: compensation, a drive loop, a loop that runs."""
    running = ["running"] if case.running else []
    return ", ".join([*filter(None, [equipment_text(case)]), *running])


def equipment_text(case: Equipped) -> str:
    """With or without compensation, and a drive loop."""
    sentences = [
        f"{COMPENSATION[case.compensation]} compensation",
        f"{COMPENSATION[case.drive_feedback]} drive loop",
    ]
    return ", ".join(text for text in sentences if not text.startswith(" "))


def case_name(case: CaseResult) -> str:
    """Return the name of a margin's case: the law and its equipment."""
    return f"{case.law} {setting_text(case)}".rstrip()


def case_title(case: CaseResult) -> str:
    """The same with its arm."""
    return f"{case.arm}, {case_name(case)}"

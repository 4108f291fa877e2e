"""The results of data sheets, as ``summary.json`` has them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, Any

from pydantic import Field

from deploy.judge.gate import Finite, Gauged
from deploy.judge.reported_values import Reflex
from deploy.reports.gauges import MM, Part
from deploy.reports.studies.case_result import COMPENSATION
from deploy.reports.studies.study_result import StudyResult
from deploy.reports.studies.study_texts import number_of
from deploy.reports.tables import Shown
from deploy.studies.margin.result import MarginResult
from deploy.studies.robustness.result import RobustnessResult
from deploy.studies.sweep.result import SweepResult

NO_NETWORK = "no network"
"""Name of the link without delays, beside the windows of a network."""


class SheetResult(StudyResult):
    """A data sheet: the answer in sentences, and its conditions.

    Attributes:
        quick: whether its runs are fewer and shorter than usual.
    """

    arm: str = ""
    law: str | None = None
    network: str | None = None
    duration_s: float = 0.0
    quick: bool = False
    headline: list[str] = Field(default=[])


def effort_text(margin: MarginResult, duration_s: float, *, is_quick: bool) -> str:
    """Return what the numbers of a data sheet rest on: starts, seeds, and length of the runs."""
    starts = 1 if margin.arms_with_one_start else len(margin.offsets)
    counted = (number_of(starts, "start"), number_of(len(margin.seeds), "seed"))
    return f"{'--quick: ' * is_quick}{', '.join(counted)}, runs of {duration_s:g} s"


def caveat_text(result: SheetResult, margin: MarginResult) -> str:
    """Return `effort_text` where a number rests on one start and one seed alone; else nothing."""
    is_least = len(margin.seeds) <= 1 and (
        len(margin.offsets) <= 1 or bool(margin.arms_with_one_start)
    )
    effort = effort_text(margin, result.duration_s, is_quick=result.quick)
    return effort if result.quick or is_least else ""


def more_windows(count: int) -> str:
    """Say how to try more windows of a network than were tried."""
    return f"more windows: --windows {2 * count}"


class Parts(Part):
    """The studies of a data sheet."""

    margin: MarginResult
    network: SweepResult | None = None
    plants: RobustnessResult | None = None

    @property
    def all(self) -> dict[str, StudyResult]:
        """Those that there are, by name."""
        return {name: each for name, each in self if each is not None}


class DataSheetResult(SheetResult):
    """A data sheet: its margin with compensation, and that of its uncertain plants."""

    group = "datasheet"
    quote: dict[str, Any] = Field(default={})
    folders: dict[str, str] = Field(default={})
    worst_window: dict[str, Any] | None = None
    parts: Parts

    def numbers(self) -> Iterator[Gauged]:
        margin = self.parts.margin
        cases = [case for case in margin.cases if case.compensation]
        yield from margin.model_copy(update={"cases": cases}).numbers()
        if self.parts.plants is not None:
            for each in self.parts.plants.numbers():
                yield replace(each, name=f"{each.name}, uncertain plants")


class Way(Part):
    """A way to drive a robot; None for what does not apply to it.

    Attributes:
        law: the law.
        preview: whether it reads its reference ahead.
        limiter: whether the robot changes commands to stay within its limits.
        compensation: whether delays are compensated.
    """

    law: str = ""
    preview: bool | None = None
    limiter: bool | None = None
    compensation: bool | None = None

    @property
    def options(self) -> dict[str, bool | None]:
        """Options that vary of the way to drive the robot."""
        return {name: getattr(self, name) for name in ("preview", "limiter", "compensation")}

    @property
    def text(self) -> str:
        """Law and options in words."""
        known = ((name, on) for name, on in self.options.items() if on is not None)
        return ", ".join([self.law, *(f"{COMPENSATION[on]} {name}" for name, on in known)])


class Driven(Way):
    """Runs of a robot that is driven in some way.

    Attributes:
        lag_ms: of the joint that is furthest behind or ahead.
    """

    tip_rms_mm: Annotated[Finite | None, Shown("Tip, RMS", "mm")] = None
    tip_largest_mm: Annotated[Finite | None, Shown("Tip, largest", "mm")]
    lag_ms: Annotated[Finite | None, Shown("Behind", "ms")] = None
    lag_joint: str | None = None


class RobotRun(Driven):
    """A run of a robot on a link."""

    link: str
    kept: bool
    verdict: str
    reflexes: list[Reflex]
    first_violation_s: float | None
    faults: list[str]
    command: str


class WayResult(Driven):
    """The runs of a way to drive a robot; errors are those of runs without a fault.

    Attributes:
        reflexes: how many runs each ended.
        worst: link of the worst run; `command` repeats it.
    """

    way: str
    runs: int
    kept: int
    reflexes: dict[str, int] = Field(default={})
    worst: str = ""
    command: str = ""


class RobotSheetResult(SheetResult):
    """A robot's data sheet: its margins, and the largest error of its tip in each way.

    Attributes:
        smooth_playout_ms: in which 99 % of the round trips over the network end.
    """

    group = "robot_datasheet"
    other_units = (MM,)
    interface: str = ""
    smooth_playout_ms: float | None = None
    margin: MarginResult
    runs_of_robot: list[RobotRun] = Field(default=[])
    ways: list[WayResult]

    def numbers(self) -> Iterator[Gauged]:
        yield from self.margin.numbers()
        for way in self.ways:
            largest = way.tip_largest_mm if way.kept == way.runs else None
            yield Gauged(f"{self.arm}, {way.way}, largest tip error", largest, MM, sign=-1)

    @property
    def asked(self) -> list[RobotRun]:
        """The runs without those on no network."""
        return [run for run in self.runs_of_robot if run.link != NO_NETWORK]

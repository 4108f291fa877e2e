"""The result of a study of a policy, as ``summary.json`` has it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

from pydantic import Field

from deploy.judge.gate import Finite, Gauged
from deploy.reports.gauges import JERK, MM, Part
from deploy.reports.studies.study_result import StudyResult
from deploy.reports.tables import Shown
from deploy.study.study import rows_by

Known = Finite | None


class Point(Part):
    """The runs of a merge at an inference time; figures are the largest of its runs.

    Attributes:
        ends: the commonest reason why a run is not tolerated.
        jump_mm: of the tip.
        starved_share: share of ticks without an action.
        bound_used: largest error over its bound; above 1 it is outside.
    """

    inference_ms: Finite
    runs: int
    runs_kept: int
    ends: str | None
    worst_point: str
    jump_rad: Annotated[Known, Shown("Largest jump", "mrad", "Jump", factor=1e3)]
    jump_mm: Annotated[Known, Shown("At the tip", "mm", "At the\ntip")]
    jerk_rad_s3: Annotated[Known, Shown("Jerk, largest", "rad/s³", "Jerk")]
    jerk_rms_rad_s3: Annotated[Known, Shown("Jerk, RMS", "rad/s³", "RMS")]
    age_median_ms: Annotated[Known, Shown("Age, median", "ms", None)]
    age_largest_ms: Annotated[Known, Shown("Age, largest", "ms", "Age")]
    starved_share: Annotated[Known, Shown("Waiting", "%", factor=100.0)]
    tip_error_rms_mm: Annotated[Known, Shown("Tip error, RMS", "mm", "Tip\nerror")]
    bound_used: Annotated[Known, Shown("Error, of its bound", "%", None, factor=100.0)] = None


class OfTasks(Part):
    """Largest inference times of the tasks; None of a task that is lost without any."""

    tasks: int
    smallest: Known
    median: Known
    largest: Known


class Merge(Part):
    """A merge of chunks on an arm.

    Attributes:
        is_whole: whether its inference times reach the limit of the study.
        inference_ms: the largest one up to which all runs are tolerated.
        is_limit: whether that is the largest one tried.
        ends: why the next one is lost.
        at: its runs at the inference time of comparisons.
    """

    arm: str
    merge: str
    is_whole: bool
    inference_ms: Known
    is_limit: bool
    ends: str | None
    of_tasks_ms: OfTasks | None
    at: Point | None
    points: list[Point]


class Alone(Part):
    """A run at the shortest inference time without the network, as no merge held with it."""

    arm: str
    merge: str
    held: bool
    ends: str | None


class PolicyResult(StudyResult):
    """A policy: its largest inference time with each merge; in mm and rad/s3, jump and jerk.

    Attributes:
        without_network: a run for each arm on which no merge held.
        torque_arms: arms without a loop of their own, to which torques go over the link.
    """

    group = "policy"
    other_units = (MM, JERK)
    title: str
    unit: str
    values: list[float]
    policy: str
    network: str | None
    at_ms: float
    limit_ms: float
    tasks: int | None
    without_network: list[Alone] = Field(default=[])
    torque_arms: list[str] = Field(default=[])
    cases: Annotated[list[Merge], Field(min_length=1)]

    def numbers(self) -> Iterator[Gauged]:
        for case in self.cases:
            name, at = f"{case.arm}, {case.merge}", case.at
            yield Gauged(f"{name}, inference time", case.inference_ms, "ms")
            if at is not None:
                where = f"at {at.inference_ms:g} ms"
                yield Gauged(f"{name}, jump of the tip {where}", at.jump_mm, MM, sign=-1)
                yield Gauged(f"{name}, jerk {where}", at.jerk_rad_s3, JERK, sign=-1)

    @property
    def arms(self) -> dict[str, list[Merge]]:
        """The merges of each arm."""
        return rows_by(self.cases, lambda case: case.arm)

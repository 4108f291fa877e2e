"""Findings about the chunks of a slow law: jumps, jerk, ages, and states without a row."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np

from bus_schema.messages.run_event import EventKind
from bus_schema.messages.topics import Role
from deploy.judge.motion.commanded_jerk import commanded_jerk
from deploy.judge.motion.tip_error import tips_apart_m
from deploy.judge.result.section import Column, Section, Spread
from deploy.judge.run_data import RunData

_MM, _MS = 1e3, 1e3


class Jump(Section):
    """Jump of the targets where a new answer took over.

    Attributes:
        time_s: time of the switch
        joint: joint whose target jumped most
        jump_rad: by how much
        jump_mm: how far the tip of the targets jumped
    """

    time_s: float
    joint: str
    jump_rad: float
    jump_mm: float | None


class Chunks(Section):
    """Answers of a law slower than the loop.

    Attributes:
        starved_ticks: states at which the law's chunk had no row left, so that the arm waited
        starved_share: share of these states
        switches: number of switches to a new answer
        jump_rad: the largest jump of a target there; null for a law without targets
        jump_mm: the largest jump of the targets' tip in `jumps` and at `jump_rad`
        jump_joint: joint of `jump_rad`
        jump_s: time of `jump_rad`
        jumps: the first 1000 of these jumps
        jerk_rad_s3: largest jerk of the commanded positions, a third difference over the time
            between two actions; null for a law without targets
        jerk_rms_rad_s3: its RMS, of the joint where that is largest
        jerk_joint: joint of `jerk_rad_s3`
        age_ms: age of the observation behind the answer in force (median, largest)
        age_bound_ms: largest age that follows from the inference time d and the time s between two
            questions, d + s with s ≥ d; null where the law chooses s
    """

    starved_ticks: int | None
    starved_share: Annotated[float | None, Column()]
    switches: int | None
    jump_rad: Annotated[float | None, Column()]
    jump_mm: Annotated[float | None, Column()]
    jump_joint: str | None
    jump_s: float | None
    jumps: list[Jump]
    jerk_rad_s3: Annotated[float | None, Column()]
    jerk_rms_rad_s3: Annotated[float | None, Column()]
    jerk_joint: str | None
    age_ms: Annotated[Spread | None, Column("age_{}_ms", entries=("median", "largest"))]
    age_bound_ms: float | None


def chunks(run: RunData) -> Chunks | None:
    """Return jumps, jerk, ages and states without a row of a law slower than the loop.

    None for other laws. Recordings of older versions have fewer of these figures.
    """
    ended = run.last_values(Role.CONTROLLER, EventKind.ENDED)
    starved, found = ended.get("starved"), ended.get("chunks") or {}
    if starved is None:
        return None
    states, ticks = found.get("states"), starved.get("ticks")
    age_s = run.setup.scenario.controller.largest_answer_age_s(1e-9 * run.setup.grid.period_ns)
    return Chunks(
        starved_ticks=ticks,
        starved_share=ticks / states if states and ticks is not None else None,
        switches=found.get("switches"),
        **_jumps(run, found),
        **_jerk(run, found),
        age_ms=found.get("age_ms"),
        age_bound_ms=None if age_s is None else _MS * age_s,
    )


def _jumps(run: RunData, found: Mapping[str, Any]) -> dict[str, Any]:
    """Return the jumps, and the largest of them."""
    largest, names = found.get("largest") or {}, run.setup.robot.joint_names
    targets = found.get("first_targets_rad") or []
    switches = found.get("first_switches", ())[: len(targets)]
    is_known = largest.get("joint", len(names)) < len(names)
    sizes_mm = _jumps_mm(run, targets) if is_known else []
    jumps = [
        Jump(time_s=time_s, joint=names[int(joint)], jump_rad=jump_rad, jump_mm=jump_mm)
        for (time_s, _, jump_rad, joint), jump_mm in zip(switches, sizes_mm, strict=False)
        if joint < len(names)
    ]
    there = _jumps_mm(run, [[largest["before_rad"], largest["after_rad"]]]) if is_known else []
    return {
        "jump_rad": largest["jump_rad"] if is_known else None,
        "jump_mm": max([*sizes_mm, *there], default=None),
        "jump_joint": names[largest["joint"]] if is_known else None,
        "jump_s": largest["time_s"] if is_known else None,
        "jumps": jumps,
    }


def _jumps_mm(run: RunData, targets: list[list[list[float]]]) -> list[float]:
    """Return how far tips of targets are apart, mm; none if these are of another arm."""
    if any(len(each) != run.setup.robot.joints for pair in targets for each in pair):
        return []
    before, after = np.reshape(targets, (-1, 2, run.setup.robot.joints)).swapaxes(0, 1)
    return [_MM * float(each) for each in tips_apart_m(run.setup.robot, before, after)]


def _jerk(run: RunData, found: Mapping[str, Any]) -> dict[str, Any]:
    jerk = commanded_jerk(run) if found.get("largest") is not None else None
    return {
        "jerk_rad_s3": None if jerk is None else jerk.largest,
        "jerk_rms_rad_s3": None if jerk is None else jerk.rms,
        "jerk_joint": None if jerk is None else run.setup.robot.joint_names[jerk.joint],
    }

"""Findings about the chunks of a slow law: jumps, ages, and states without a row."""

from __future__ import annotations

from typing import Any

import numpy as np

from bus_schema.messages.run_event import EventKind
from bus_schema.messages.topics import Role
from deploy.judge.result.section import Section, Spread
from deploy.judge.run_data import RunData
from deploy.judge.tip_error import tips_apart_m


class Chunks(Section):
    """Answers of a law slower than the loop.

    Attributes:
        starved_ticks: states at which the law's chunk had no row left
        starved_share: share of these states
        switches: number of switches to a new answer
        jump_rad: the largest jump of a target there; null for a law without targets
        jump_mm: jump of the tip there
        jump_joint: joint of that jump
        jump_s: time of that jump
        age_ms: age of the observation behind the answer in force (median, largest)
    """

    starved_ticks: int | None
    starved_share: float | None
    switches: int | None
    jump_rad: float | None
    jump_mm: float | None
    jump_joint: str | None
    jump_s: float | None
    age_ms: Spread | None


def chunks(run: RunData) -> Chunks | None:
    """Return jumps, ages and states without a row of a law slower than the loop; None for others.

    Recordings of older versions have the states without a row alone.
    """
    ended = run.last_values(Role.CONTROLLER, EventKind.ENDED)
    starved, found = ended.get("starved"), ended.get("chunks") or {}
    if starved is None:
        return None
    largest, names = found.get("largest") or {}, run.setup.robot.joint_names
    is_known = largest.get("joint", len(names)) < len(names)
    states, ticks = found.get("states"), starved.get("ticks")
    return Chunks(
        starved_ticks=ticks,
        starved_share=ticks / states if states and ticks is not None else None,
        switches=found.get("switches"),
        jump_rad=largest["jump_rad"] if is_known else None,
        jump_mm=_jump_mm(run, largest) if is_known else None,
        jump_joint=names[largest["joint"]] if is_known else None,
        jump_s=largest["time_s"] if is_known else None,
        age_ms=found.get("age_ms"),
    )


def _jump_mm(run: RunData, largest: dict[str, Any]) -> float | None:
    """Return how far the tip of the targets jumped, mm; None if these are of another arm."""
    positions = [np.array([largest[each]]) for each in ("before_rad", "after_rad")]
    if any(each.shape != (1, run.setup.robot.joints) for each in positions):
        return None
    return 1e3 * float(tips_apart_m(run.setup.robot, *positions)[0])

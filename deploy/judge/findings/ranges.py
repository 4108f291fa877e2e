"""Joints that pass the ends of their ranges, where a real arm has stops."""

from __future__ import annotations

import numpy as np

from bus_schema.messages import topics
from deploy.judge.result.section import Section
from deploy.judge.run_data import RunData, stamps_s

_LEAST_SHARE = 0.1
"""Of a joint's range; less is what a law that keeps a reference at the end of it needs."""


class BeyondRange(Section):
    """A joint that passes an end of its range by more than 10 % of it.

    Attributes:
        joint: its name
        beyond_rad: how far at most; m where it slides
        time_s: time of that
    """

    joint: str
    beyond_rad: float
    time_s: float


def beyond_ranges(run: RunData) -> list[BeyondRange]:
    """Return the joints that pass an end of their range by much."""
    truth, robot = run.tables[topics.PLANT_TRUTH.name], run.setup.robot
    if not len(truth):
        return []
    positions = np.nan_to_num(truth["position"], nan=0.0, posinf=np.inf, neginf=-np.inf)
    beyond = np.maximum(positions - robot.upper_rad, robot.lower_rad - positions)
    ticks, ranges = beyond.argmax(axis=0), robot.upper_rad - robot.lower_rad
    times_s = stamps_s(truth)
    return [
        BeyondRange(joint=name, beyond_rad=float(most), time_s=float(times_s[tick]))
        for name, tick, most, whole in zip(
            robot.joint_names, ticks, beyond.max(axis=0), ranges, strict=True
        )
        if most > _LEAST_SHARE * whole
    ]

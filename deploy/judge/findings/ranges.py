"""Joints that pass the ends of their ranges, where a real arm has stops."""

from __future__ import annotations

from typing import Any

import numpy as np

from bus_schema.messages import topics
from deploy.judge.run_data import RunData, stamps_s

_LEAST_SHARE = 0.1
"""Of a joint's range; less is what a law that keeps a reference at the end of it needs."""


def beyond_ranges(run: RunData) -> list[dict[str, Any]]:
    """Return the joints that pass an end of their range by much.

    Each has ``joint``, ``beyond_rad`` (how far at most) and ``time_s`` (when that was).
    """
    truth, robot = run.tables[topics.PLANT_TRUTH.name], run.setup.robot
    if not len(truth):
        return []
    positions = np.nan_to_num(truth["position"], nan=0.0, posinf=np.inf, neginf=-np.inf)
    beyond = np.maximum(positions - robot.upper_rad, robot.lower_rad - positions)
    ticks, ranges = beyond.argmax(axis=0), robot.upper_rad - robot.lower_rad
    times_s = stamps_s(truth)
    return [
        {"joint": name, "beyond_rad": float(most), "time_s": float(times_s[tick])}
        for name, tick, most, whole in zip(
            robot.joint_names, ticks, beyond.max(axis=0), ranges, strict=True
        )
        if most > _LEAST_SHARE * whole
    ]

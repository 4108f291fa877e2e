"""The lag of joints: the time by which they are behind their reference."""

from __future__ import annotations

import numpy as np

from bus_schema.messages import topics
from deploy.judge.run_data import RunData

_MS = 1e3
_STILL_RAD_S = 1e-6
"""RMS of a reference's velocity; slower ones show no lag."""


def lag_ms(run: RunData) -> list[float | None]:
    """Return the lag of each joint, ms: least squares of true error against reference velocity.

    From ``metrics.from_s`` on; None for a joint whose reference rests, and negative for one that
    is ahead.
    """
    judged = run.times_s(topics.PLANT_TRUTH) >= run.setup.scenario.metrics.from_s
    errors, speeds = run.true_errors_rad[judged], run.reference_velocities_rad_s[judged]
    square = (speeds**2).sum(axis=0)
    moves = square > _STILL_RAD_S**2 * max(len(speeds), 1)
    with np.errstate(invalid="ignore", over="ignore"):
        found = -_MS * (errors * speeds).sum(axis=0) / np.where(moves, square, np.nan)
    return [float(each) if np.isfinite(each) else None for each in found]

"""The lag of joints: the time by which they are behind their reference."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bus_schema.messages import topics
from deploy.judge.run_data import ROBOT_SERVER, RunData

_MS = 1e3
_STILL_RAD_S = 1e-6
"""RMS of a reference's velocity; slower ones show no lag."""


def lag_ms(run: RunData) -> list[float | None]:
    """Return the lag of each joint's true error, ms, from ``metrics.from_s`` on.

    None for a joint whose reference rests, and negative for one that is ahead.
    """
    judged = run.times_s(topics.PLANT_TRUTH) >= run.setup.scenario.metrics.from_s
    if run.link == ROBOT_SERVER:  # a client may ask for nothing, or a jump, which show no lag
        limits = run.setup.robot.velocity_limits_rad_s
        judged &= (np.abs(run.reference_velocities_rad_s) <= limits).all(axis=1)
        judged &= run.tables[topics.PLANT_TRUTH.name]["command_age_ns"] >= 0
    errors, speeds = run.true_errors_rad[judged], run.reference_velocities_rad_s[judged]
    return [_MS * float(each) if np.isfinite(each) else None for each in lags_s(errors, speeds)]


def lags_s(
    errors_rad: NDArray[np.float64], velocities_rad_s: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the time T of e = −T q̇_d, s, by least squares over all ticks; NaN where q̇_d rests.

    Args:
        errors_rad: shape (ticks,) or (ticks, joints).
        velocities_rad_s: of the reference, same shape.
    """
    square = (velocities_rad_s**2).sum(axis=0)
    moves = square > _STILL_RAD_S**2 * max(len(velocities_rad_s), 1)
    with np.errstate(invalid="ignore", over="ignore"):
        product = (errors_rad * velocities_rad_s).sum(axis=0)
        return np.asarray(-product / np.where(moves, square, np.nan))

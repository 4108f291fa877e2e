"""A lag: an error that is proportional to the reference's speed, as of a transport delay."""

from __future__ import annotations

import math

import numpy as np

from bus_schema.arrays import Vector
from deploy.judge.joint_lag import lags_s

_EXPLAINED = 0.95
"""Share of the error's square; other smooth errors have it only with lags longer than they last."""
_LEFT_AT_END = 0.3
"""Share of the last error, which left the bounds."""
_TIMES_ITS_LENGTH = 2.0
"""A lag shows only in a longer time."""


def lag_s(errors_rad: Vector, velocities_rad_s: Vector, duration_s: float) -> float | None:
    """Return the time T of e = −T q̇_d, s, as `lags_s`; None if that is not what the error is.

    Args:
        errors_rad: of a joint, shape (ticks,).
        velocities_rad_s: of its reference, same shape.
        duration_s: of these ticks.
    """
    size, lag = float((errors_rad**2).sum()), float(lags_s(errors_rad, velocities_rad_s))
    if not (size > 0.0 and math.isfinite(lag)):
        return None
    left = np.abs(errors_rad + lag * velocities_rad_s)
    is_explained = float((left**2).sum()) <= (1.0 - _EXPLAINED) * size
    is_at_end = left[-1] <= _LEFT_AT_END * abs(errors_rad[-1])
    is_seen = 0.0 < lag * _TIMES_ITS_LENGTH <= duration_s
    return lag if is_explained and is_at_end and is_seen else None

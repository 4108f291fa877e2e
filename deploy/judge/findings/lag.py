"""A lag: an error that is proportional to the reference's speed, as of a transport delay."""

from __future__ import annotations

from bus_schema.arrays import Vector

_EXPLAINED = 0.95
"""Share of the error's square; other smooth errors reach that only by lags longer than they last."""
_TIMES_ITS_LENGTH = 2.0
"""A lag shows only in a longer time."""


def lag_s(errors_rad: Vector, velocities_rad_s: Vector, duration_s: float) -> float | None:
    """Return the time T of e = −T q̇_d, s, by least squares; None if that is not what the error is.

    Args:
        errors_rad: of a joint, shape (ticks,).
        velocities_rad_s: of its reference, same shape.
        duration_s: of these ticks.
    """
    moved, size = float((velocities_rad_s**2).sum()), float((errors_rad**2).sum())
    if not (moved > 0.0 and size > 0.0):
        return None
    lag = -float((errors_rad * velocities_rad_s).sum()) / moved
    left = float(((errors_rad + lag * velocities_rad_s) ** 2).sum())
    is_lag = left <= (1.0 - _EXPLAINED) * size and 0.0 < lag * _TIMES_ITS_LENGTH <= duration_s
    return lag if is_lag else None

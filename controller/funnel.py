"""Prescribed performance: the funnel, and the transformation of the error inside it.

After section 3 of the paper: one performance function bounds the side the error comes from
(convergence), the other the far side (overshoot), both decreasing to one steady-state bound. The
transformation that is zero exactly at zero error, also while the two bounds differ, is ours.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.runtime.compiled import compiled


@dataclass(frozen=True)
class Funnel:
    """Bounds on the error of every joint, shape (joints,) each.

    Attributes:
        initial_upper_rad: upper bound at time zero.
        initial_lower_rad: size of the lower bound at time zero.
        final_rad: size of both bounds in the long run.
        rate_per_s: rate at which the bounds shrink.
    """

    initial_upper_rad: Vector
    initial_lower_rad: Vector
    final_rad: Vector
    rate_per_s: float

    def bounds(self, time_s: Vector) -> tuple[Vector, Vector]:
        """Upper and (negative) lower bound in rad at each time, shapes (times, joints)."""
        decay = np.exp(-self.rate_per_s * np.asarray(time_s, dtype=np.float64))[:, None]
        upper = (self.initial_upper_rad - self.final_rad) * decay + self.final_rad
        lower = (self.initial_lower_rad - self.final_rad) * decay + self.final_rad
        return upper, -lower


@compiled
def performance_function(
    time_s: float, initial: float, final: float, rate: float
) -> tuple[float, float, float]:
    """ρ(t) = (ρ₀ − ρ∞) e^(−μt) + ρ∞ with its first and second derivative."""
    transient = (initial - final) * math.exp(-rate * time_s)
    return transient + final, -rate * transient, rate * rate * transient


@compiled
def transform(error: float, upper: float, lower: float) -> float:
    """ε = ½ ln[(1 + e/l) / (1 − e/u)] for −l < e < u."""
    return 0.5 * math.log((1.0 + error / lower) / (1.0 - error / upper))


@compiled
def inverse_transform(transformed: float, upper: float, lower: float) -> float:
    """E = l u (E − 1) / (u + l E) with E = e^(2ε)."""
    growth = math.exp(2.0 * transformed)
    return lower * upper * (growth - 1.0) / (upper + lower * growth)


@compiled
def transformation_rates(
    error: float, upper: float, lower: float, d_upper: float, d_lower: float
) -> tuple[float, float]:
    """R = ∂ε/∂e and the error rate v of the moving funnel, so that ε̇ = r (ė − v)."""
    r = 0.5 * (1.0 / (lower + error) + 1.0 / (upper - error))
    w = 0.5 * (
        error * d_lower / (lower * (lower + error)) + error * d_upper / (upper * (upper - error))
    )
    return r, w / r


@compiled
def transformation_accelerations(
    error: float, error_rate: float,
    upper: float, lower: float,
    d_upper: float, d_lower: float,
    dd_upper: float, dd_lower: float,
) -> tuple[float, float]:  # fmt: skip
    """ṙ and v̇ along a motion with error rate ė."""
    r, v = transformation_rates(error, upper, lower, d_upper, d_lower)
    below, above = lower + error, upper - error
    d_r = -0.5 * (
        (d_lower + error_rate) / (below * below) + (d_upper - error_rate) / (above * above)
    )
    d_w = 0.5 * (
        _rate_of_drift_term(
            error, error_rate, lower, d_lower, dd_lower, below, d_lower + error_rate
        )
        + _rate_of_drift_term(
            error, error_rate, upper, d_upper, dd_upper, above, d_upper - error_rate
        )
    )
    return d_r, (d_w - v * d_r) / r


@compiled
def _rate_of_drift_term(
    error: float, error_rate: float,
    bound: float, d_bound: float, dd_bound: float,
    gap: float, d_gap: float,
) -> float:  # fmt: skip
    """Time derivative of e ρ̇ / (ρ g), with g the gap between error and bound."""
    numerator = error * d_bound
    denominator = bound * gap
    d_numerator = error_rate * d_bound + error * dd_bound
    d_denominator = d_bound * gap + bound * d_gap
    return (d_numerator * denominator - numerator * d_denominator) / (denominator * denominator)

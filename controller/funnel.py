"""Prescribed performance: the funnel, and the transformation of the error inside it.

After section 3 of the paper: one performance function bounds the side the error comes from
(convergence), the other the far side (overshoot), both decreasing to one steady-state bound. The
transformation is ours: it is zero exactly at zero error, even if the two bounds differ.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from pydantic import Field

from bus_schema.arrays import Vector, elementwise
from bus_schema.configuration import (
    ConfigurationError,
    NonNegative,
    PerJointPositive,
    Positive,
    StrictModel,
    expand,
)
from bus_schema.runtime.compiled import bind, compiled


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
        """Return upper and (negative) lower bounds in rad at each time, shapes (times, joints)."""
        times = np.asarray(time_s, dtype=np.float64)
        decay = elementwise(math.exp, -self.rate_per_s * times)[:, None]
        upper = (self.initial_upper_rad - self.final_rad) * decay + self.final_rad
        lower = (self.initial_lower_rad - self.final_rad) * decay + self.final_rad
        return upper, -lower

    def counting(self, position: Vector, wanted: Vector, counts: Vector) -> Callable[[float], None]:
        """Return a function of time that updates `counts` for a tick of the motion in these arrays.

        Args:
            position: joint positions, rad, shape (joints,).
            wanted: their references.
            counts: ticks, those outside the bounds, and the largest |e| over the bound.
        """
        bounds = self.initial_upper_rad, self.initial_lower_rad, self.final_rad, self.rate_per_s
        return bind(_count, *bounds, position, wanted, counts, free=["float64"])

    def copied(self) -> Funnel:
        """Return the same bounds in separate arrays."""
        names = ("initial_upper_rad", "initial_lower_rad", "final_rad")
        return replace(self, **{name: getattr(self, name).copy() for name in names})


Bound: TypeAlias = tuple[float, float, float]
"""Size of a bound, rad, with its first and second derivative."""


@compiled
def performance_function(time_s: float, initial: float, final: float, rate: float) -> Bound:
    """Return ρ(t) = (ρ₀ − ρ∞) e^(−μt) + ρ∞ with its first and second derivative."""
    transient = (initial - final) * math.exp(-rate * time_s)
    return transient + final, -rate * transient, rate * rate * transient


@compiled
def _count(
    upper: Vector, lower: Vector, final: Vector, rate: float,
    position: Vector, wanted: Vector, counts: Vector, time_s: float,
) -> None:  # fmt: skip
    decay, is_outside = math.exp(-rate * time_s), False
    for i in range(final.size):
        error = position[i] - wanted[i]
        initial = upper[i] if error >= 0.0 else lower[i]
        usage = abs(error) / ((initial - final[i]) * decay + final[i])
        is_outside = is_outside or not usage < 1.0
        counts[2] = max(counts[2], usage if usage == usage else math.inf)
    counts[0] += 1.0
    counts[1] += is_outside


@compiled
def transform(error: float, upper: Bound, lower: Bound) -> float:
    """Return ε = ½ ln[(1 + e/l) / (1 − e/u)] for −l < e < u."""
    return 0.5 * math.log((1.0 + error / lower[0]) / (1.0 - error / upper[0]))


@compiled
def transformation_rates(error: float, upper: Bound, lower: Bound) -> tuple[float, float]:
    """Return r = ∂ε/∂e and the error rate v of the moving funnel, so that ε̇ = r (ė − v)."""
    u, d_u, _ = upper
    lo, d_lo, _ = lower
    r = 0.5 * (1.0 / (lo + error) + 1.0 / (u - error))
    w = 0.5 * (error * d_lo / (lo * (lo + error)) + error * d_u / (u * (u - error)))
    return r, w / r


@compiled
def transformation_accelerations(
    error: float, error_rate: float, upper: Bound, lower: Bound
) -> tuple[float, float]:
    """Return ṙ and v̇ along a motion with error rate ė."""
    r, v = transformation_rates(error, upper, lower)
    below, above = lower[0] + error, upper[0] - error
    d_below, d_above = lower[1] + error_rate, upper[1] - error_rate
    d_r = -0.5 * (d_below / (below * below) + d_above / (above * above))
    d_w = 0.5 * (
        _rate_of_drift_term(error, error_rate, lower, below, d_below)
        + _rate_of_drift_term(error, error_rate, upper, above, d_above)
    )
    return d_r, (d_w - v * d_r) / r


@compiled
def _rate_of_drift_term(
    error: float, error_rate: float, bound: Bound, gap: float, d_gap: float
) -> float:
    """Return the time derivative of e ρ̇ / (ρ g), with g the gap between error and bound."""
    rho, d_rho, dd_rho = bound
    numerator = error * d_rho
    denominator = rho * gap
    d_numerator = error_rate * d_rho + error * dd_rho
    d_denominator = d_rho * gap + rho * d_gap
    return (d_numerator * denominator - numerator * d_denominator) / (denominator * denominator)


class FunnelConfiguration(StrictModel):
    """The prescribed performance: initial width of the funnel, rate and final width of its closing.

    The funnel opens to ``convergence_scale × |e(0)| + convergence_margin_rad`` on the side of the
    initial error e(0) and to ``overshoot_scale × |e(0)| + overshoot_margin_rad`` on the other, but
    never beyond ``widest_rad``; both sides close to ``final_rad`` at ``rate_per_s``.
    """

    convergence_scale: NonNegative = 1.2
    convergence_margin_rad: NonNegative = 0.05
    overshoot_scale: NonNegative = 0.4
    overshoot_margin_rad: NonNegative = 0.03
    widest_rad: Positive = 1.5
    final_rad: PerJointPositive = Field(default_factory=lambda: np.array([0.01]))
    rate_per_s: Positive = 4.0

    def build(self, initial_error_rad: Vector) -> Funnel:
        """Return the funnel for an initial error, shape (joints,).

        Raises:
            ConfigurationError: the initial error is outside, or a side would have to widen.
        """
        joints = initial_error_rad.size
        final = expand(self.final_rad, joints, "funnel.final_rad")
        size = np.abs(initial_error_rad)
        near = self.convergence_scale * size + self.convergence_margin_rad
        far = self.overshoot_scale * size + self.overshoot_margin_rad
        near, far = np.minimum(near, self.widest_rad), np.minimum(far, self.widest_rad)
        if np.any(size >= near):
            joint = int(np.argmax(size - near))
            raise ConfigurationError(
                "robot.initial_offset_rad",
                initial_error_rad.tolist(),
                f"the initial error of joint {joint + 1} must be inside the funnel, whose bound"
                f" is {near[joint]:.4g} rad there",
            )
        if np.any(far < final) or np.any(near < final):
            raise ConfigurationError("funnel.final_rad", final.tolist(), self._least(size, final))
        above = initial_error_rad >= 0.0
        return Funnel(
            np.where(above, near, far), np.where(above, far, near), final, self.rate_per_s
        )

    def _least(self, size: Vector, final: Vector) -> str:
        """Return what the other keys must be at least for the final bounds.

        Args:
            size: of the initial errors, shape (joints,).
            final: bounds in the long run, shape (joints,).
        """
        needed = {
            "convergence_margin_rad": final - self.convergence_scale * size,
            "overshoot_margin_rad": final - self.overshoot_scale * size,
            "widest_rad": final,
        }
        raised = {
            key: math.ceil(1e4 * float(least.max())) / 1e4
            for key, least in needed.items()
            if least.max() > getattr(self, key)
        }
        wishes = " and ".join(
            f"funnel.{key} to at least {least:g}" for key, least in raised.items()
        )
        return f"must not exceed the bounds at time zero: lower it, or raise {wishes}"

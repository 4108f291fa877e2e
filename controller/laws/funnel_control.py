"""Funnel control: the gain grows as the error nears its bound; no model, no memory.

    w = (e α(e²/ψ²) + ė/λ) / (σ ψ),    τ = −K α(w²) w,    α(x) = 1 / (1 − x)

After Berger, Ilchmann and Ryan, Funnel control of nonlinear systems (2021), for relative degree
two, per joint. ψ is the bound on the side of the error. Ours are the scales λ and σ, which the
theory takes as 1: λ makes an error of a velocity, and σ is the opening of the second funnel, that
of w, in bounds. Beyond 99 % of either funnel, where the theory has no value, the gain stays finite.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.configuration import PerJointPositive, Positive
from bus_schema.runtime.compiled import compiled
from controller.control_law import LOWER, UPPER, Diagnostics, Dynamics, Tracking
from controller.laws.sliding_mode import default_stiffness

_LARGEST = 0.99


class FunnelControlGains(NamedTuple):
    """Torque K, N m, and rate λ, 1/s, per joint; opening σ of the second funnel, in bounds."""

    torque_nm: PerJointPositive
    rate: PerJointPositive
    opening: Positive = 2.0

    @classmethod
    def from_inertia(cls, inertia_kg_m2: Vector) -> FunnelControlGains:
        """Return gains for which a funnel of 10 mrad is stiff, and damped."""
        torque_nm = 0.08 * default_stiffness(inertia_kg_m2) * inertia_kg_m2
        return cls(torque_nm, 30.0 * np.ones_like(inertia_kg_m2))


class FunnelControl:
    """The law."""

    def __init__(
        self, gains: FunnelControlGains, _model: Dynamics, _torque_limits_nm: Vector
    ) -> None:
        self.diagnostics = Diagnostics(gains.rate.size)
        self._gains = gains
        self._torque: Vector = np.zeros(gains.rate.size)

    def reset(self) -> None:
        """Do nothing: there is no state."""

    def torque(self, tracking: Tracking) -> Vector:
        _torque(tracking.error, tracking.error_rate, tracking.bounds, self._gains, self._torque)
        return self._torque


@compiled
def _torque(
    error: Vector, error_rate: Vector, bounds: Matrix, gains: FunnelControlGains, torque: Vector
) -> None:
    for i in range(error.size):
        bound = bounds[UPPER, i] if error[i] >= 0.0 else bounds[LOWER, i]
        near = _stretched(error[i] / bound)
        w = _stretched((near + error_rate[i] / (gains.rate[i] * bound)) / gains.opening)
        torque[i] = -gains.torque_nm[i] * w


@compiled
def _stretched(share: float) -> float:
    """Return α(x²) x, which continues as a line beyond the largest share."""
    inside = min(max(share, -_LARGEST), _LARGEST)
    gain = 1.0 / (1.0 - inside * inside)
    return gain * share

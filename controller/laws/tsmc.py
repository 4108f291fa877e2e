"""Terminal sliding mode control: a rival of the paper's section 5, on a nominal model.

    s = ė + β sig(e)^(q/p),    τ = Ĉ q̇ + Ĝ + M̂ (q̈_d − β (q/p) |e|^(q/p − 1) ė − K sign s − k s).

Below |e| = η the power is continued by a quadratic of equal value and slope (as in ψ, see
`surface_pull`), which bounds the slope that is infinite at zero.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.compiled import compiled
from bus_schema.configuration import (
    NonNegative,
    PerJointNonNegative,
    PerJointPositive,
    Positive,
    PowerBelowOne,
)
from controller.control_law import Diagnostics, Dynamics, Tracking
from controller.sliding_surface import default_switching, surface_pull, surface_pull_slope, switch


class TsmcGains(NamedTuple):
    """Surface gain β, switching gain K (rad/s²) and linear gain k (1/s) per joint; power q/p.

    Inside ±boundary_layer (rad/s) the sign gives way to a straight line; 0 for none.
    """

    beta: PerJointPositive
    switching: PerJointNonNegative
    linear: PerJointNonNegative
    power: PowerBelowOne = 7.0 / 9.0
    eta: Positive = 1e-3
    boundary_layer: NonNegative = 0.0

    @classmethod
    def from_inertia(cls, inertia_kg_m2: Vector) -> TsmcGains:
        """The same for all joints but for the switching, as M̂ already scales by inertia."""
        one = np.ones_like(inertia_kg_m2)
        return cls(beta=4.0 * one, switching=default_switching(inertia_kg_m2), linear=10.0 * one)


class Tsmc:
    """The law on a nominal model."""

    def __init__(self, gains: TsmcGains, model: Dynamics) -> None:
        joints = gains.beta.size
        self.gains = gains
        self.diagnostics = Diagnostics(joints)
        self._model = model
        self._acceleration: Vector = np.zeros(joints)

    def reset(self) -> None:
        """Nothing to forget: the law has no memory."""

    def torque(self, tracking: Tracking) -> Vector:
        _acceleration(
            tracking.error,
            tracking.error_rate,
            tracking.reference_acceleration,
            self.gains,
            self.diagnostics.sliding_variable,
            self._acceleration,
        )
        return self._model.inverse_dynamics(
            tracking.position, tracking.velocity, self._acceleration
        )


@compiled
def _acceleration(
    error: Vector, error_rate: Vector, reference_acceleration: Vector, gains: TsmcGains,
    sliding: Vector, acceleration: Vector,
) -> None:  # fmt: skip
    g = gains
    for i in range(error.size):
        pull = surface_pull(error[i], 0.0, g.beta[i], 1.0, g.power, g.eta)
        pull_slope = surface_pull_slope(error[i], 0.0, g.beta[i], 1.0, g.power, g.eta)
        s = error_rate[i] + pull
        reaching = g.switching[i] * switch(s, g.boundary_layer) + g.linear[i] * s
        acceleration[i] = reference_acceleration[i] - pull_slope * error_rate[i] - reaching
        sliding[i] = s

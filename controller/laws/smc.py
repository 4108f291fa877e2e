"""Sliding mode control on a linear surface: a rival of the paper's section 5, on a nominal model.

s = ė + λ e,    τ = Ĉ q̇ + Ĝ + M̂ (q̈_d − λ ė − K sign s − k s).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.compiled import compiled
from bus_schema.configuration import NonNegative, PerJointNonNegative, PerJointPositive
from controller.control_law import Diagnostics, Dynamics, Tracking
from controller.sliding_surface import default_switching, switch


class SmcGains(NamedTuple):
    """Slope of the surface λ (1/s), switching gain K (rad/s²) and linear gain k (1/s) per joint.

    Inside ±boundary_layer (rad/s) the sign gives way to a straight line; 0 for none.
    """

    slope: PerJointPositive
    switching: PerJointNonNegative
    linear: PerJointNonNegative
    boundary_layer: NonNegative = 0.0

    @classmethod
    def from_inertia(cls, inertia_kg_m2: Vector) -> SmcGains:
        """The same for all joints but for the switching, as M̂ already scales by inertia."""
        one = np.ones_like(inertia_kg_m2)
        return cls(slope=8.0 * one, switching=default_switching(inertia_kg_m2), linear=10.0 * one)


class Smc:
    """The law on a nominal model."""

    def __init__(self, gains: SmcGains, model: Dynamics) -> None:
        joints = gains.slope.size
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
    error: Vector, error_rate: Vector, reference_acceleration: Vector, gains: SmcGains,
    sliding: Vector, acceleration: Vector,
) -> None:  # fmt: skip
    g = gains
    for i in range(error.size):
        s = error_rate[i] + g.slope[i] * error[i]
        reaching = g.switching[i] * switch(s, g.boundary_layer) + g.linear[i] * s
        acceleration[i] = reference_acceleration[i] - g.slope[i] * error_rate[i] - reaching
        sliding[i] = s

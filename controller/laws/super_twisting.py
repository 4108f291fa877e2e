"""Super-twisting on a nominal model: a second-order sliding mode, whose torque does not jump.

    s = ė + λ e,    τ = Ĉ q̇ + Ĝ + M̂ (q̈_d − λ ė − k₁ √|s| sign s + v),    dv/dt = −k₂ sign s

After Levant, Sliding order and sliding accuracy (1993), and Moreno and Osorio (2012), per joint. A
disturbance whose acceleration changes by up to L per second needs about k₁ = 1.5 √L, k₂ = 1.1 L.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.configuration import PerJointPositive
from bus_schema.runtime.compiled import compiled
from controller.control_law import may_accumulate
from controller.laws.computed_torque import InverseDynamicsLaw
from controller.laws.sliding_mode import default_switching


class SuperTwistingGains(NamedTuple):
    """Slope λ, 1/s, and gains k₁, rad/s² per √(rad/s), and k₂, rad/s³, per joint."""

    slope: PerJointPositive
    root: PerJointPositive
    twisting: PerJointPositive

    @classmethod
    def from_inertia(cls, inertia_kg_m2: Vector) -> SuperTwistingGains:
        """Return gains for a disturbance that reverses the default switching in a third second."""
        change = 6.0 * default_switching(inertia_kg_m2)
        return cls(10.0 * np.ones_like(inertia_kg_m2), 1.5 * np.sqrt(change), 1.1 * change)


@compiled
def _acceleration(
    error: Vector, error_rate: Vector, reference_acceleration: Vector, step_s: float,
    gains: SuperTwistingGains, torque: Vector, limits: Vector,
    integral: Vector, sliding: Vector, acceleration: Vector,
) -> None:  # fmt: skip
    g = gains
    for i in range(error.size):
        s = error_rate[i] + g.slope[i] * error[i]
        sign = 0.0 if s == 0.0 else math.copysign(1.0, s)
        if may_accumulate(torque[i], s, limits[i]):
            integral[i] -= step_s * g.twisting[i] * sign
        reach = g.root[i] * math.sqrt(abs(s)) * sign - integral[i]
        acceleration[i] = reference_acceleration[i] - g.slope[i] * error_rate[i] - reach
        sliding[i] = s


class SuperTwisting(InverseDynamicsLaw):
    """The law; v is its integral."""

    acceleration = staticmethod(_acceleration)

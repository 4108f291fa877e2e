"""Computed torque with an integral: the textbook's law for arms with a model.

    τ = M̂ (q̈_d − K_d ė − K_p e − K_i ∫e) + Ĉ q̇ + Ĝ

After Siciliano et al., Robotics (2009), section 8.5.2 (inverse dynamics control). Gains are per
unit of inertia, so they are equal for all joints unless given.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.configuration import PerJointNonNegative, PerJointPositive
from bus_schema.runtime.compiled import compiled
from controller.control_law import Diagnostics, Dynamics, Tracking, may_accumulate
from controller.laws.sliding_mode import default_stiffness


class ComputedTorqueGains(NamedTuple):
    """Gains per joint: K_p in 1/s², K_i in 1/s³, K_d in 1/s."""

    proportional: PerJointPositive
    integral: PerJointNonNegative
    derivative: PerJointPositive

    @classmethod
    def from_inertia(cls, inertia_kg_m2: Vector) -> ComputedTorqueGains:
        """Return the default stiffness, and three equal poles."""
        stiffness = default_stiffness(inertia_kg_m2)
        pole = np.sqrt(stiffness / 3.0)
        return cls(stiffness, pole * pole * pole, 3.0 * pole)


class InverseDynamicsLaw:
    """The torque of an acceleration that has an integral; the base of laws with a model.

    A law of this kind has a compiled function `acceleration` that updates the integral, unless a
    joint saturates and it would change outwards, and the acceleration.
    """

    acceleration: Callable[..., None]

    def __init__(self, gains: Any, model: Dynamics, torque_limits_nm: Vector) -> None:
        joints = gains[0].size
        self.diagnostics = Diagnostics(joints)
        self._gains, self._model, self._limits = gains, model, torque_limits_nm
        self._integral: Vector = np.zeros(joints)
        self._torque: Vector = np.zeros(joints)
        self._acceleration: Vector = np.zeros(joints)

    def reset(self) -> None:
        self._integral[:] = 0.0
        self._torque[:] = 0.0

    def torque(self, tracking: Tracking) -> Vector:
        self.acceleration(
            tracking.error, tracking.error_rate, tracking.reference_acceleration, tracking.step_s,
            self._gains, self._torque, self._limits, self._integral,
            self.diagnostics.sliding_variable, self._acceleration,
        )  # fmt: skip
        self._torque[:] = self._model.inverse_dynamics(
            tracking.position, tracking.velocity, self._acceleration
        )
        return self._torque


@compiled
def _acceleration(
    error: Vector, error_rate: Vector, reference_acceleration: Vector, step_s: float,
    gains: ComputedTorqueGains, torque: Vector, limits: Vector,
    integral: Vector, _sliding: Vector, acceleration: Vector,
) -> None:  # fmt: skip
    g = gains
    for i in range(error.size):
        if may_accumulate(torque[i], error[i], limits[i]):
            integral[i] += step_s * error[i]
        acceleration[i] = reference_acceleration[i] - (
            g.proportional[i] * error[i]
            + g.integral[i] * integral[i]
            + g.derivative[i] * error_rate[i]
        )


class ComputedTorque(InverseDynamicsLaw):
    """The law."""

    acceleration = staticmethod(_acceleration)

"""PID on the joint errors, the model-free baseline of the paper's section 5; with gravity too.

pid           τ = −K_p e − K_i ∫e − K_d ė
pid_gravity   τ = −K_p e − K_i ∫e − K_d ė + Ĝ(q), after Siciliano et al., Robotics (2009),
section 8.5.1; what industrial arms run.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.configuration import PerJointNonNegative, PerJointPositive
from bus_schema.runtime.compiled import compiled
from controller.control_law import Diagnostics, Dynamics, Tracking, may_accumulate
from controller.laws.sliding_mode import default_stiffness


class PidGains(NamedTuple):
    """Gains per joint, in N m per rad, per rad s and per rad/s."""

    proportional: PerJointPositive
    integral: PerJointNonNegative
    derivative: PerJointPositive

    @classmethod
    def from_inertia(cls, inertia_kg_m2: Vector) -> PidGains:
        """Return gains for joints with these inertias: `paper_arm`'s mean gains per kg m²."""
        return cls(800.0 * inertia_kg_m2, 400.0 * inertia_kg_m2, 90.0 * inertia_kg_m2)


class PidGravityGains(NamedTuple):
    """As `PidGains`."""

    proportional: PerJointPositive
    integral: PerJointNonNegative
    derivative: PerJointPositive

    @classmethod
    def from_inertia(cls, inertia_kg_m2: Vector) -> PidGravityGains:
        """Return critically damped joints of the default stiffness, and a slow integral."""
        stiffness = default_stiffness(inertia_kg_m2)
        proportional = stiffness * inertia_kg_m2
        return cls(proportional, 2.0 * proportional, 2.0 * np.sqrt(stiffness) * inertia_kg_m2)


Gains = PidGains | PidGravityGains


class Pid:
    """The law; while a joint saturates, its integral changes only inwards."""

    def __init__(
        self, gains: PidGains | PidGravityGains, _model: Dynamics, torque_limits_nm: Vector
    ) -> None:
        joints = gains.proportional.size
        self.gains = gains
        self.diagnostics = Diagnostics(joints)
        self._limits = torque_limits_nm
        self._integral: Vector = np.zeros(joints)
        self._torque: Vector = np.zeros(joints)

    def reset(self) -> None:
        self._integral[:] = 0.0
        self._torque[:] = 0.0

    def torque(self, tracking: Tracking) -> Vector:
        _feedback(
            tracking.error, tracking.error_rate, tracking.step_s, self.gains, self._limits,
            self._torque, self._integral,
        )  # fmt: skip
        return self._torque


class PidGravity(Pid):
    """The law with the gravity of the nominal model."""

    def __init__(self, gains: PidGravityGains, model: Dynamics, torque_limits_nm: Vector) -> None:
        super().__init__(gains, model, torque_limits_nm)
        self._model = model
        self._at_rest: Vector = np.zeros(gains.proportional.size)

    def torque(self, tracking: Tracking) -> Vector:
        gravity = self._model.inverse_dynamics(tracking.position, self._at_rest, self._at_rest)
        feedback = super().torque(tracking)
        feedback += gravity  # also what is compared with the limits at the next tick
        return feedback


@compiled
def _feedback(
    error: Vector, error_rate: Vector, step_s: float, gains: Gains, limits: Vector,
    torque: Vector, integral: Vector,
) -> None:  # fmt: skip
    """Replace the last torque, whose saturation decides on the integral, by the feedback."""
    g = gains
    for i in range(error.size):
        if may_accumulate(torque[i], error[i], limits[i]):
            integral[i] += step_s * error[i]
        torque[i] = -(
            g.proportional[i] * error[i]
            + g.integral[i] * integral[i]
            + g.derivative[i] * error_rate[i]
        )

"""PID on the joint errors: the model-free baseline of the paper's section 5."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.configuration import PerJointNonNegative, PerJointPositive
from bus_schema.runtime.compiled import compiled
from controller.control_law import Diagnostics, Dynamics, Tracking, may_accumulate


class PidGains(NamedTuple):
    """Gains per joint, in N m per rad, per rad s and per rad/s."""

    proportional: PerJointPositive
    integral: PerJointNonNegative
    derivative: PerJointPositive

    @classmethod
    def from_inertia(cls, inertia_kg_m2: Vector) -> PidGains:
        """Return gains for joints with these inertias: `paper_arm`'s mean gains per kg m²."""
        return cls(800.0 * inertia_kg_m2, 400.0 * inertia_kg_m2, 90.0 * inertia_kg_m2)


class Pid:
    """τ = −K_p e − K_i ∫e − K_d ė; while a joint saturates, its integral changes only inwards."""

    def __init__(self, gains: PidGains, _model: Dynamics, torque_limits_nm: Vector) -> None:
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
        _torque(
            tracking.error, tracking.error_rate, tracking.step_s, self.gains, self._limits,
            self._integral, self._torque,
        )  # fmt: skip
        return self._torque


@compiled
def _torque(
    error: Vector, error_rate: Vector, step_s: float, gains: PidGains, limits: Vector,
    integral: Vector, torque: Vector,
) -> None:  # fmt: skip
    g = gains
    for i in range(error.size):
        if may_accumulate(torque[i], error[i], limits[i]):
            integral[i] += step_s * error[i]
        torque[i] = -(
            g.proportional[i] * error[i]
            + g.integral[i] * integral[i]
            + g.derivative[i] * error_rate[i]
        )

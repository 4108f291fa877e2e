"""Time-delay control: the torque and acceleration of a moment ago stand in for a model.

    τ = M̄ (q̈_d − K_d ė − K_p e) + τ(t − L) − M̄ q̈(t − L),    M̄ diagonal

After Youcef-Toumi and Ito (1990) and Hsia and Gao (1990). L is the time between two measurements;
q̈(t − L) is the change of the velocity since the last one over that time. τ(t − L) is the torque
that was requested, within the joint's limits: with a delay of the transport it is not yet the one
that acts. Stable without delay where M̄ is below twice the arm's inertia.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.configuration import PerJointPositive
from bus_schema.runtime.compiled import compiled
from controller.control_law import Diagnostics, Dynamics, Tracking


class TimeDelayControlGains(NamedTuple):
    """Inertia M̄, kg m², K_p, 1/s², and K_d, 1/s, per joint."""

    inertia_kg_m2: PerJointPositive
    proportional: PerJointPositive
    derivative: PerJointPositive

    @classmethod
    def from_inertia(cls, inertia_kg_m2: Vector) -> TimeDelayControlGains:
        """Return half of the inertia, and critically damped joints of 15 rad/s."""
        one = np.ones_like(inertia_kg_m2)
        return cls(0.5 * inertia_kg_m2, 225.0 * one, 30.0 * one)


class TimeDelayControl:
    """The law. What it remembers of torques is limited, so that no saturation winds it up."""

    def __init__(
        self, gains: TimeDelayControlGains, _model: Dynamics, torque_limits_nm: Vector
    ) -> None:
        joints = gains.proportional.size
        self.diagnostics = Diagnostics(joints)
        self._gains, self._limits = gains, torque_limits_nm
        self._has_begun = False
        self._memory = _Memory(*np.zeros((3, joints)))

    def reset(self) -> None:
        self._has_begun = False
        for values in self._memory:
            values[:] = 0.0

    def torque(self, tracking: Tracking) -> Vector:
        _torque(
            tracking.error, tracking.error_rate, tracking.reference_acceleration,
            tracking.velocity, tracking.step_s if self._has_begun else 0.0, self._gains,
            self._limits, self._memory,
        )  # fmt: skip
        self._has_begun = True
        return self._memory.torque


class _Memory(NamedTuple):
    """Last velocity and requested torque, and τ − M̄ q̈ then, shape (joints,)."""

    velocity: Vector
    torque: Vector
    disturbance: Vector


@compiled
def _torque(
    error: Vector, error_rate: Vector, reference_acceleration: Vector, velocity: Vector,
    step_s: float, gains: TimeDelayControlGains, limits: Vector, memory: _Memory,
) -> None:  # fmt: skip
    g = gains
    for i in range(error.size):
        if step_s > 0.0:
            acted = min(max(memory.torque[i], -limits[i]), limits[i])
            acceleration = (velocity[i] - memory.velocity[i]) / step_s
            memory.disturbance[i] = acted - g.inertia_kg_m2[i] * acceleration
        wanted = (
            reference_acceleration[i]
            - g.derivative[i] * error_rate[i]
            - g.proportional[i] * error[i]
        )
        memory.velocity[i] = velocity[i]
        memory.torque[i] = g.inertia_kg_m2[i] * wanted + memory.disturbance[i]

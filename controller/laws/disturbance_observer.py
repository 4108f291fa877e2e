"""PD on a nominal inertia with a disturbance observer: the loop of most industrial drives.

    τ = M̄ (q̈_d − K_d ė − K_p e) + d̂,    d̂ = g/(s + g) (τ + g M̄ q̇) − g M̄ q̇,    M̄ diagonal

After Ohnishi, Shibata and Murakami (1996), with a Q-filter of first order and the velocity, so that
nothing is differentiated. d̂ estimates all that is not M̄ q̈: gravity, friction, coupling. The torque
that the observer sees is the requested one within the joint's limits.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.configuration import PerJointPositive, Positive
from bus_schema.runtime.compiled import compiled
from controller.control_law import Diagnostics, Dynamics, Tracking
from controller.laws.sliding_mode import default_stiffness


class DisturbanceObserverGains(NamedTuple):
    """Inertia M̄, kg m², K_p, 1/s², and K_d, 1/s, per joint; bandwidth g of the filter, rad/s."""

    inertia_kg_m2: PerJointPositive
    proportional: PerJointPositive
    derivative: PerJointPositive
    bandwidth_rad_s: Positive = 400.0

    @classmethod
    def from_inertia(cls, inertia_kg_m2: Vector) -> DisturbanceObserverGains:
        """Return critically damped joints of the default stiffness."""
        stiffness = default_stiffness(inertia_kg_m2)
        return cls(inertia_kg_m2, stiffness, 2.0 * np.sqrt(stiffness))


class DisturbanceObserver:
    """The law. The observer sees limited torques, so that no saturation winds it up."""

    def __init__(
        self, gains: DisturbanceObserverGains, _model: Dynamics, torque_limits_nm: Vector
    ) -> None:
        joints = gains.proportional.size
        self.diagnostics = Diagnostics(joints)
        self._gains, self._limits = gains, torque_limits_nm
        self._memory = _Memory(*np.zeros((3, joints)))

    def reset(self) -> None:
        for values in self._memory:
            values[:] = 0.0

    def torque(self, tracking: Tracking) -> Vector:
        _torque(
            tracking.error, tracking.error_rate, tracking.reference_acceleration,
            tracking.velocity, tracking.step_s, self._gains, self._limits, self._memory,
        )  # fmt: skip
        return self._memory.torque


class _Memory(NamedTuple):
    """Last velocity and requested torque, and the output of the filter, shape (joints,)."""

    velocity: Vector
    torque: Vector
    filtered: Vector


@compiled
def _torque(
    error: Vector, error_rate: Vector, reference_acceleration: Vector, velocity: Vector,
    step_s: float, gains: DisturbanceObserverGains, limits: Vector, memory: _Memory,
) -> None:  # fmt: skip
    g = gains
    new = 1.0 - math.exp(-g.bandwidth_rad_s * step_s)
    for i in range(error.size):
        momentum = g.bandwidth_rad_s * g.inertia_kg_m2[i]
        acted = min(max(memory.torque[i], -limits[i]), limits[i])
        seen = acted + momentum * memory.velocity[i]
        memory.filtered[i] += new * (seen - memory.filtered[i])
        wanted = (
            reference_acceleration[i]
            - g.derivative[i] * error_rate[i]
            - g.proportional[i] * error[i]
        )
        memory.velocity[i] = velocity[i]
        estimate = memory.filtered[i] - momentum * velocity[i]
        memory.torque[i] = g.inertia_kg_m2[i] * wanted + estimate

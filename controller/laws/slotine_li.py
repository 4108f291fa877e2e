"""Slotine and Li's adaptive law: the parameters of the links are learned along the motion.

    s = ė + λ e,    q̇_r = q̇_d − λ e
    τ = Y(q, q̇, q̇_r, q̈_r) â − K s,    dâ/dt = −γ Yᵀ s

After Slotine and Li, On the adaptive control of robot manipulators (1987). â starts at the nominal
model: ten parameters per link, each in sizes of that link, so that one γ serves all. Combinations
of them that no motion shows stay as they are, which is why no base parameters have to be found.
The inertia of rotors is not learned: the model has it. Nothing bounds â under a disturbance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.configuration import NonNegative, PerJointPositive
from bus_schema.runtime.compiled import compiled
from controller.control_law import Diagnostics, Dynamics, Tracking, may_accumulate
from controller.laws.sliding_mode import default_stiffness


class SlotineLiGains(NamedTuple):
    """Slope λ, 1/s, and damping K, N m s/rad, per joint; rate of adaptation γ, 1/J."""

    slope: PerJointPositive
    damping: PerJointPositive
    adaptation: NonNegative = 0.03

    @classmethod
    def from_inertia(cls, inertia_kg_m2: Vector) -> SlotineLiGains:
        """Return critically damped joints of the default stiffness."""
        root = np.sqrt(default_stiffness(inertia_kg_m2))
        return cls(0.5 * root, 2.0 * root * inertia_kg_m2)


class SlotineLi:
    """The law; while a joint saturates, its error changes the parameters only inwards."""

    def __init__(self, gains: SlotineLiGains, model: Dynamics, torque_limits_nm: Vector) -> None:
        joints = gains.slope.size
        self.diagnostics = Diagnostics(joints)
        self._gains, self._model, self._limits = gains, model, torque_limits_nm
        self._change: Vector = np.zeros(model.inertial_parameters().size)
        self._torque: Vector = np.zeros(joints)

    def reset(self) -> None:
        self._change[:] = 0.0
        self._torque[:] = 0.0

    def torque(self, tracking: Tracking) -> Vector:
        slope, position, velocity = self._gains.slope, tracking.position, tracking.velocity
        along = tracking.reference_velocity - slope * tracking.error
        acceleration = tracking.reference_acceleration - slope * tracking.error_rate
        sliding = tracking.error_rate + slope * tracking.error
        regressor = self._model.regressor(position, velocity, along, acceleration)
        nominal = self._model.torque_along(position, velocity, along, acceleration)
        _learn(
            regressor, sliding, tracking.step_s, self._gains, self._limits,
            self._change, nominal, self._torque,
        )  # fmt: skip
        self.diagnostics.sliding_variable[:] = sliding
        return self._torque


@compiled
def _learn(
    regressor: Matrix, sliding: Vector, step_s: float, gains: SlotineLiGains, limits: Vector,
    change: Vector, nominal: Vector, torque: Vector,
) -> None:  # fmt: skip
    """Update the change of the parameters, and write the torque."""
    for i in range(sliding.size):
        if may_accumulate(torque[i], sliding[i], limits[i]):
            for k in range(change.size):
                change[k] -= step_s * gains.adaptation * regressor[i, k] * sliding[i]
    for i in range(sliding.size):
        learned = 0.0
        for k in range(change.size):
            learned += regressor[i, k] * change[k]
        torque[i] = nominal[i] + learned - gains.damping[i] * sliding[i]

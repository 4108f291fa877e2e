"""A control law with gains in the scenario's section ``controller.gains.impedance``."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.configuration import PerJointPositive, Positive
from controller.control_law import Diagnostics, Dynamics, Tracking
from controller.laws import LawEntry


class ImpedanceGains(NamedTuple):
    """Stiffness in N m per rad and joint; damping as a share of the critical one for 1 kg m²."""

    stiffness: PerJointPositive
    damping_ratio: Positive = 1.0

    @classmethod
    def from_inertia(cls, inertia_kg_m2: Vector) -> ImpedanceGains:
        return cls(900.0 * inertia_kg_m2)


class Impedance:
    """Springs and dampers about the reference, on top of the torque that follows it."""

    def __init__(self, gains: ImpedanceGains, model: Dynamics, torque_limits_nm: Vector) -> None:
        self.gains, self.model = gains, model
        self.diagnostics = Diagnostics(torque_limits_nm.size)

    def reset(self) -> None:
        pass

    def torque(self, tracking: Tracking) -> Vector:
        feedback = self.gains.stiffness * tracking.error
        damping = 2.0 * self.gains.damping_ratio * np.sqrt(self.gains.stiffness)
        feedback = feedback + damping * tracking.error_rate
        ahead = tracking.reference_acceleration
        return self.model.inverse_dynamics(tracking.position, tracking.velocity, ahead) - feedback


IMPEDANCE = LawEntry(Impedance, ImpedanceGains)

"""PID on the joint errors: the model-free rival of the paper's section 5."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.configuration import PerJointNonNegative, PerJointPositive
from controller.control_law import Diagnostics, Tracking


class PidGains(NamedTuple):
    """Gains per joint, in N m per rad, per rad s and per rad/s."""

    proportional: PerJointPositive
    integral: PerJointNonNegative
    derivative: PerJointPositive

    @classmethod
    def from_inertia(cls, inertia_kg_m2: Vector) -> PidGains:
        """Gains for joints that see these inertias: `paper_arm`'s, on average, per kg m²."""
        return cls(800.0 * inertia_kg_m2, 400.0 * inertia_kg_m2, 90.0 * inertia_kg_m2)


class Pid:
    """τ = −K_p e − K_i ∫e − K_d ė."""

    def __init__(self, gains: PidGains) -> None:
        self.gains = gains
        self.diagnostics = Diagnostics(gains.proportional.size)
        self._integral: Vector = np.zeros(gains.proportional.size)

    def reset(self) -> None:
        self._integral[:] = 0.0

    def torque(self, tracking: Tracking) -> Vector:
        self._integral += tracking.step_s * tracking.error
        return -(
            self.gains.proportional * tracking.error
            + self.gains.integral * self._integral
            + self.gains.derivative * tracking.error_rate
        )

"""Position correction: the reference, and a filtered share of the measured error.

    q* = q_d − k_p ē − k_i ∫ē,    ē' = ω (e − ē)

A robot's controller follows q*; the correction removes what it leaves.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.configuration import PerJointNonNegative, PerJointPositive
from bus_schema.runtime.compiled import compiled
from controller.control_law import Dynamics, Tracking
from controller.outer_laws.outer_law import OuterLaw


class PositionCorrectionGains(NamedTuple):
    """Gains per joint: share k_p, k_i in 1/s, and the filter's bandwidth ω in rad/s."""

    proportional: PerJointNonNegative
    integral: PerJointNonNegative
    filter_rad_s: PerJointPositive

    @classmethod
    def from_inertia(cls, inertia_kg_m2: Vector) -> PositionCorrectionGains:
        """Return a slow integral: a robot's position loop does not feel the inertia."""
        ones = np.ones(inertia_kg_m2.size)
        return cls(0.0 * ones, 1.0 * ones, 20.0 * ones)


class PositionCorrection(OuterLaw):
    """The law. The error is against the reference as it was when the state was measured."""

    def __init__(self, gains: PositionCorrectionGains, _model: Dynamics, limits_nm: Vector) -> None:
        super().__init__(limits_nm.size)
        self._gains: Any = gains
        self._memory: Matrix = np.zeros((2, limits_nm.size))

    def reset(self) -> None:
        """Forget filter and integral."""
        self._memory[:] = 0.0

    def target(self, tracking: Tracking) -> Matrix:
        """Return corrected positions, and the velocity of the reference; shape (2, joints)."""
        ahead = self.ahead(tracking)
        _correct(tracking.error, tracking.step_s, self._gains, self._memory, self._target[0])
        self._target[0] += ahead[0]
        self._target[1] = ahead[1]
        return self._target


@compiled
def _correct(
    error: Vector, step_s: float, gains: PositionCorrectionGains, memory: Matrix, correction: Vector
) -> None:
    """Update filter and integral, the rows of `memory`, and write −k_p ē − k_i ∫ē."""
    filtered, integral = memory
    for i in range(error.size):
        share = 1.0 - math.exp(-gains.filter_rad_s[i] * step_s)
        filtered[i] += share * (error[i] - filtered[i])
        integral[i] += step_s * filtered[i]
        correction[i] = -gains.proportional[i] * filtered[i] - gains.integral[i] * integral[i]

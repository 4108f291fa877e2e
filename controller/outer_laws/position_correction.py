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
        self._filtered, self._integral = np.zeros((2, limits_nm.size))

    def reset(self) -> None:
        """Forget filter and integral."""
        self._filtered[:] = 0.0
        self._integral[:] = 0.0

    def target(self, tracking: Tracking) -> Matrix:
        """Return corrected positions, and the velocity of the reference; shape (2, joints)."""
        gains, step_s, ahead = self._gains, tracking.step_s, self.ahead(tracking)
        share = [1.0 - math.exp(-each * step_s) for each in gains.filter_rad_s]  # not by SIMD
        self._filtered += share * (tracking.error - self._filtered)
        self._integral += step_s * self._filtered
        correction = gains.proportional * self._filtered + gains.integral * self._integral
        self._target[0] = ahead[0] - correction
        self._target[1] = ahead[1]
        return self._target

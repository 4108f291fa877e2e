"""Proportional velocity: q̇* = q̇_d − k_p e, the loop of visual servoing.

After Chaumette and Hutchinson, Visual servo control I (2006), section II. In continuous time, with
an ideal velocity servo, it is stable up to a round trip of π / (2 k_p).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.configuration import PerJointPositive
from controller.control_law import Dynamics, Tracking
from controller.outer_laws.outer_law import OuterLaw

_DEFAULT_PER_S = 5.0


class ProportionalVelocityGains(NamedTuple):
    """Gain per joint: k_p in 1/s."""

    k_p: PerJointPositive

    @classmethod
    def from_inertia(cls, inertia_kg_m2: Vector) -> ProportionalVelocityGains:
        """Return 5/s for all joints: a velocity loop does not feel their inertia."""
        return cls(np.full(inertia_kg_m2.size, _DEFAULT_PER_S))


class ProportionalVelocity(OuterLaw):
    """The law. The velocity of the reference goes ahead by the preview; the error does not."""

    def __init__(
        self, gains: ProportionalVelocityGains, _model: Dynamics, limits_nm: Vector
    ) -> None:
        super().__init__(limits_nm.size)
        self._gains: Any = gains

    def target(self, tracking: Tracking) -> Matrix:
        """Return the previewed position, and the velocity that closes the loop; (2, joints)."""
        ahead = self.ahead(tracking)
        self._target[0] = ahead[0]
        self._target[1] = ahead[1] - self._gains.k_p * tracking.error
        return self._target

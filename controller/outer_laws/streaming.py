"""Streaming: the reference itself, ahead by what the link and the robot take."""

from __future__ import annotations

from typing import Any, NamedTuple

from bus_schema.arrays import Matrix, Vector
from bus_schema.configuration import PerJointNonNegative
from controller.control_law import Dynamics, Tracking
from controller.outer_laws.outer_law import OuterLaw


class StreamingGains(NamedTuple):
    """Gain per joint: share of the reference's velocity that goes along, 1 for all of it."""

    velocity_share: PerJointNonNegative

    @classmethod
    def from_inertia(cls, inertia_kg_m2: Vector) -> StreamingGains:
        """Return the whole velocity."""
        return cls(0.0 * inertia_kg_m2 + 1.0)


class Streaming(OuterLaw):
    """The law; nothing is measured, so no delay makes it unstable."""

    def __init__(self, gains: StreamingGains, _model: Dynamics, limits_nm: Vector) -> None:
        super().__init__(limits_nm.size)
        self._gains: Any = gains

    def target(self, tracking: Tracking) -> Matrix:
        """Return the previewed reference, shape (2, joints)."""
        ahead = self.ahead(tracking)
        self._target[0] = ahead[0]
        self._target[1] = self._gains.velocity_share * ahead[1]
        return self._target

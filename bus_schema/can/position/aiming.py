"""What masters of drives that take targets have in common."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.can.codec import CanCodec
from bus_schema.can.frame import CanFrame
from bus_schema.can.master import CanMaster
from bus_schema.drive_feedback import DriveGains


class TargetCodec(CanCodec, Protocol):
    """A codec whose frames can carry targets."""

    def command_frames(
        self, torque_nm: Vector, target: Matrix, gains: DriveGains
    ) -> Sequence[CanFrame]:
        """Frames with a torque and a target for each joint.

        Args:
            torque_nm: shape (joints,).
            target: positions, rad, and velocities, rad/s, as rows, shape (2, joints).
            gains: of the loop that the drives close around it.
        """


class AimingMaster(CanMaster):
    """A master whose torques go with the last target, if there is one and no stop."""

    _codec: TargetCodec
    _aim: tuple[Matrix, DriveGains] | None = None

    def aim(self, target: Matrix, gains: DriveGains) -> None:
        self._aim = None if np.isnan(target).any() else (target, gains)

    def command(self, torque_nm: Vector) -> None:
        if self._aim is None or self._is_stopping:
            super().command(torque_nm)
        else:
            self._send(self._codec.command_frames(torque_nm, *self._aim))

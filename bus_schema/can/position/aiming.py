"""What codecs and masters of drives that take targets have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
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


class AimingCodec(ABC):
    """Makes the codec that it is mixed into a `TargetCodec` for drives that were set their gains.

    Torques without a target go with where the joints were seen last, and how they moved.

    Attributes:
        _seen: that, as rows like those of a target; zeros at first, set by the codec.
    """

    _seen: Matrix

    def read_state(self, frame: CanFrame, position: Vector, velocity: Vector) -> int | None:
        joint: int | None = super().read_state(  # type: ignore[misc]  # that of the codec
            frame, position, velocity
        )
        if joint is not None:
            self._seen[:, joint] = position[joint], velocity[joint]
        return joint

    def torque_frames(self, torque_nm: Vector) -> Sequence[CanFrame]:
        return self._frames(torque_nm, self._seen)

    def command_frames(
        self,
        torque_nm: Vector,
        target: Matrix,
        gains: DriveGains,  # noqa: ARG002 (the drives have them already)
    ) -> Sequence[CanFrame]:
        return self._frames(torque_nm, target)

    @abstractmethod
    def _frames(self, torque_nm: Vector, target: Matrix) -> Sequence[CanFrame]:
        """Frames with a torque and a target for each joint."""


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

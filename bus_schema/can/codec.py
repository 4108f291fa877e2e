"""Cyclic traffic between a master and its drives: which frames sample, report and command."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.can.frame import CanFrame
from bus_schema.can.frame_timing import CycleFrames


class CanCodec(Protocol):
    """The frames of one control cycle of a protocol, in one mode; joints are counted from 0.

    Attributes:
        cycle: how many frames of which length these are.
    """

    cycle: CycleFrames

    def sampling_frames(self) -> Sequence[CanFrame]:
        """Frames by which the master has all drives sample their joints."""

    def is_sampling(self, frame: CanFrame) -> bool:
        """Whether a frame is one of those."""

    def read_state(self, frame: CanFrame, position: Vector, velocity: Vector) -> int | None:
        """Decode the state of a joint, rad and rad/s; the joint, None for any other frame.

        Args:
            frame: any frame.
            position: where its position is written, shape (joints,).
            velocity: where its velocity is written, shape (joints,).
        """

    def command_frames(self, torque_nm: Vector, target: Matrix | None = None) -> Sequence[CanFrame]:
        """Frames with a torque for each joint, and with a target in a mode that has one.

        Args:
            torque_nm: shape (joints,).
            target: positions, rad, and velocities, rad/s, as rows, shape (2, joints). Without one
                a drive gets what moves it least: no gains, or a target where it was seen last.
        """

    def read_torque(self, frame: CanFrame, torque_nm: Vector) -> int | None:
        """Decode the torque for a joint, as rounded for the wire; the joint, None if it has none.

        Args:
            frame: any frame.
            torque_nm: where the torque is written, shape (joints,).
        """


def as_delivered(codec: CanCodec, torque_nm: Vector) -> Vector:
    """What the drives receive of these torques, shape (joints,)."""
    delivered = np.zeros_like(torque_nm)
    for frame in codec.command_frames(torque_nm):
        codec.read_torque(frame, delivered)
    return delivered

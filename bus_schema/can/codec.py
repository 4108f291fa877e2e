"""Frames of a control cycle: requests for states, their answers, and commands."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.can.frame import CanFrame
from bus_schema.can.frame_timing import CycleFrames


class AxisState(NamedTuple):
    """State that a drive reports.

    Attributes:
        node_id: address of the drive, as far as the frame contains it.
        position_rad: position of the joint.
        velocity_rad_s: its velocity.
        torque_nm: torque of the motor; 0 where the frame has none.
        temperature_c: temperature of the motor; 0 where the frame has none.
        error: error code of the protocol; 0 for none.
    """

    node_id: int
    position_rad: float
    velocity_rad_s: float
    torque_nm: float = 0.0
    temperature_c: int = 0
    error: int = 0


class CanCodec(ABC):
    """Frames of one control cycle of a protocol, in one mode; joints are counted from 0.

    Args:
        node_ids: addresses of the drives, one for each joint.
        sampling: frames that request the states of all drives.

    Attributes:
        cycle: number and length of the frames.
    """

    cycle: CycleFrames

    def __init__(self, node_ids: Sequence[int], sampling: Sequence[CanFrame]) -> None:
        self._node_ids, self._sampling = tuple(node_ids), sampling
        self._joint_of = {node_id: joint for joint, node_id in enumerate(node_ids)}
        self._last_motion = [(0.0, 0.0)] * len(self._node_ids)

    def sampling_frames(self) -> Sequence[CanFrame]:
        """Return the frames with which the master requests the states of all drives."""
        return self._sampling

    def is_sampling(self, frame: CanFrame) -> bool:
        """Whether a frame is one of those."""
        return frame in self._sampling

    @abstractmethod
    def reply(self, frame: CanFrame) -> tuple[int, AxisState] | None:
        """Return the joint and the state in an answer; None for any other frame."""

    def read_state(self, frame: CanFrame, position: Vector, velocity: Vector) -> int | None:
        """Decode the state of a joint; return the joint, or None for any other frame.

        Args:
            frame: any frame.
            position: receives its position, rad, shape (joints,).
            velocity: receives its velocity, rad/s, shape (joints,).
        """
        found = self.reply(frame)
        if found is None:
            return None
        joint, state = found
        self._last_motion[joint] = motion = state[1:3]
        position[joint], velocity[joint] = motion
        return joint

    @abstractmethod
    def command_frames(self, torque_nm: Vector, target: Matrix | None = None) -> Sequence[CanFrame]:
        """Return frames with a torque for each joint, and a target in a mode that has one.

        Args:
            torque_nm: shape (joints,).
            target: positions, rad, and velocities, rad/s, as rows, shape (2, joints). Without one
                a drive gets no gains, or its last reported motion as target.
        """

    @abstractmethod
    def read_torque(self, frame: CanFrame, torque_nm: Vector) -> int | None:
        """Decode the torque for a joint, rounded as on the wire; return the joint, or None.

        Args:
            frame: any frame.
            torque_nm: receives the torque, shape (joints,).
        """

    def _target_or_last(self, target: Matrix | None) -> Matrix:
        """Return the target, by default the last reported motion, shape (2, joints)."""
        return np.array(self._last_motion).T if target is None else target


def as_delivered(codec: CanCodec, torque_nm: Vector) -> Vector:
    """Return what the drives receive of these torques, shape (joints,)."""
    delivered = np.zeros_like(torque_nm)
    for frame in codec.command_frames(torque_nm):
        codec.read_torque(frame, delivered)
    return delivered

"""Cyclic traffic between a master and its drives: which frames ask, tell and command."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.can.cansimple_codec import CanSimpleCodec
from bus_schema.can.cia402_codec import Cia402Codec
from bus_schema.can.frame import CanFrame
from bus_schema.can.units import DriveUnits, rated_torque_nm
from bus_schema.link.can_configuration import CanConfiguration
from bus_schema.robot_description import RobotDescription


class CanCodec(Protocol):
    """The frames of one control cycle of a protocol; joints are counted from 0."""

    def sampling_frames(self) -> Sequence[CanFrame]:
        """Frames by which the master has all drives sample their joints."""
        ...

    def is_sampling(self, frame: CanFrame) -> bool:
        """Whether a frame is one of those."""
        ...

    def read_state(self, frame: CanFrame, position: Vector, velocity: Vector) -> int | None:
        """Write what a drive tells of its joint, rad and rad/s; the joint, None if it is no such.

        Args:
            frame: any frame.
            position: shape (joints,).
            velocity: shape (joints,).
        """
        ...

    def torque_frames(self, torque_nm: Vector) -> Sequence[CanFrame]:
        """Frames with a torque for each joint, shape (joints,)."""
        ...

    def read_torque(self, frame: CanFrame, torque_nm: Vector) -> int | None:
        """Write the torque in a frame, as rounded for the wire; the joint, None if it has none."""
        ...


def build_codec(can: CanConfiguration, robot: RobotDescription) -> CanCodec:
    """The codec of a scenario.

    Raises:
        ConfigurationError: a value does not fit the robot.
    """
    node_ids = can.node_ids_of(robot.joints)
    if can.protocol == "cansimple":
        return CanSimpleCodec(node_ids)
    return Cia402Codec(node_ids, DriveUnits(can.counts_per_turn, rated_torque_nm(can, robot)))


def as_delivered(codec: CanCodec, torque_nm: Vector) -> Vector:
    """What the drives get of these torques, shape (joints,)."""
    delivered = np.zeros_like(torque_nm)
    for frame in codec.torque_frames(torque_nm):
        codec.read_torque(frame, delivered)
    return delivered

"""Cyclic frames of ODrive axes on CANSimple, as ODrive's public protocol description has them.

A cycle is, for each axis, a remote frame that asks for its encoder estimates, the answer (turns,
turns per second) and the torque to give. Axes must not send estimates unasked
(``encoder_msg_rate_ms = 0``): an answer could not be distinguished from one of those.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence

from bus_schema.arrays import Vector
from bus_schema.can.frame import CanFrame, is_classical_data
from bus_schema.can.frame_timing import CycleFrames

COMMAND_BITS = 5
HEARTBEAT, SET_AXIS_STATE, GET_ENCODER_ESTIMATES = 0x01, 0x07, 0x09
SET_CONTROLLER_MODE, SET_INPUT_POS, SET_INPUT_TORQUE, CLEAR_ERRORS = 0x0B, 0x0C, 0x0E, 0x18

_ESTIMATES = struct.Struct("<ff")
_TORQUE = struct.Struct("<f")
_TURN_RAD = 2.0 * math.pi


def identifier(node_id: int, command: int) -> int:
    """CAN identifier of a message to or from an axis."""
    return node_id << COMMAND_BITS | command


class CanSimpleCodec:
    """Frames of one control cycle, see `CanCodec`.

    Args:
        node_ids: addresses of the axes, one for each joint.
    """

    cycle = CycleFrames(
        (), (0, 8, 4), "{n} × (request + encoder estimates 8 bytes + torque 4 bytes)"
    )

    def __init__(self, node_ids: Sequence[int]) -> None:
        estimates = [identifier(node_id, GET_ENCODER_ESTIMATES) for node_id in node_ids]
        self._torques = [identifier(node_id, SET_INPUT_TORQUE) for node_id in node_ids]
        self._requests = tuple(CanFrame(each, is_remote=True) for each in estimates)
        self._joint_of_estimates = {each: joint for joint, each in enumerate(estimates)}
        self._joint_of_torque = {each: joint for joint, each in enumerate(self._torques)}

    def sampling_frames(self) -> Sequence[CanFrame]:
        return self._requests

    def is_sampling(self, frame: CanFrame) -> bool:
        return frame.is_remote and frame.identifier in self._joint_of_estimates

    def read_state(self, frame: CanFrame, position: Vector, velocity: Vector) -> int | None:
        joint = self._joint_of_estimates.get(frame.identifier)
        if joint is None or not is_classical_data(frame, _ESTIMATES.size):
            return None
        turns, turns_per_s = _ESTIMATES.unpack(frame.data)
        position[joint] = turns * _TURN_RAD
        velocity[joint] = turns_per_s * _TURN_RAD
        return joint

    def torque_frames(self, torque_nm: Vector) -> Sequence[CanFrame]:
        return [
            CanFrame(each, _TORQUE.pack(torque))
            for each, torque in zip(self._torques, torque_nm.tolist(), strict=True)
        ]

    def read_torque(self, frame: CanFrame, torque_nm: Vector) -> int | None:
        joint = self._joint_of_torque.get(frame.identifier)
        if joint is None or not is_classical_data(frame, _TORQUE.size):
            return None
        (torque_nm[joint],) = _TORQUE.unpack(frame.data)
        return joint

"""Cyclic frames of ODrive axes on CANSimple, as ODrive's public protocol description has them.

A cycle is, for each axis, a remote frame that asks for its encoder estimates, the answer (turns,
turns per second) and the input: a torque, or in position control a position with velocity and
torque feed-forward, each 16 bits in steps that the axis and its master must agree on
(``input_vel_scale``, ``input_torque_scale``). Axes must not send estimates unasked
(``encoder_msg_rate_ms = 0``): an answer could not be distinguished from one of those.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.can.codec import AxisState, CanCodec
from bus_schema.can.frame import CanFrame, is_data
from bus_schema.can.frame_timing import CycleFrames
from bus_schema.drive_feedback import DriveGains
from bus_schema.link.can_configuration import CanSimpleConfiguration

COMMAND_BITS = 5
TURN_RAD = 2.0 * math.pi

_ESTIMATES = struct.Struct("<ff")
_WORD = np.iinfo(np.int16)


class CommandId(IntEnum):
    """Kind of a message: the lowest bits of its identifier."""

    HEARTBEAT = 0x01
    SET_AXIS_STATE = 0x07
    GET_ENCODER_ESTIMATES = 0x09
    SET_CONTROLLER_MODE = 0x0B
    SET_INPUT_POS = 0x0C
    SET_INPUT_TORQUE = 0x0E
    CLEAR_ERRORS = 0x18
    SET_POS_GAIN = 0x1A
    SET_VEL_GAINS = 0x1B


class OdriveState(IntEnum):
    """The axis states in use."""

    IDLE = 1
    CLOSED_LOOP_CONTROL = 8


PASSTHROUGH = 1
"""Input mode in which an axis uses its inputs unchanged."""


class CanSimpleMode(NamedTuple):
    """Quantity that an axis controls, with the frames of a cycle.

    Attributes:
        control: the control mode.
        input: command that sets the input.
        layout: of its data; the torque is the last number.
        cycle: frames of a cycle.
    """

    control: int
    input: CommandId
    layout: struct.Struct
    cycle: CycleFrames


TORQUE = CanSimpleMode(
    1, CommandId.SET_INPUT_TORQUE, struct.Struct("<f"),
    CycleFrames((), (0, 8, 4), "{n} × (request + encoder estimates 8 bytes + torque 4 bytes)"),
)  # fmt: skip
POSITION = CanSimpleMode(
    3, CommandId.SET_INPUT_POS, struct.Struct("<fhh"),
    CycleFrames((), (0, 8, 8), "{n} × (request + encoder estimates 8 bytes + position 8 bytes)"),
)  # fmt: skip


def identifier(node_id: int, command: int) -> int:
    """CAN identifier of a message to or from an axis."""
    return node_id << COMMAND_BITS | command


class CanSimpleCodec(CanCodec):
    """Frames of one control cycle, see `CanCodec`.

    Args:
        node_ids: addresses of the axes, one for each joint.
        gains: of the loops that axes close in position control; None for torque control.
        scales: of the feed-forwards.

    Attributes:
        gains: see above.
        mode: what the axes control.
    """

    def __init__(
        self,
        node_ids: Sequence[int],
        gains: DriveGains | None = None,
        scales: CanSimpleConfiguration | None = None,
    ) -> None:
        self.gains, self._scales = gains, scales or CanSimpleConfiguration()
        self.mode = TORQUE if gains is None else POSITION
        self.cycle = self.mode.cycle
        estimates = [identifier(node_id, CommandId.GET_ENCODER_ESTIMATES) for node_id in node_ids]
        super().__init__(node_ids, [CanFrame(each, is_remote=True) for each in estimates])
        self._joint_of_estimates = {each: joint for joint, each in enumerate(estimates)}
        self._inputs = [identifier(node_id, self.mode.input) for node_id in node_ids]
        self._torque_scale = 1.0 if gains is None else self._scales.input_torque_scale

    def reply(self, frame: CanFrame) -> tuple[int, AxisState] | None:
        joint = self._joint_of_estimates.get(frame.identifier)
        if joint is None or not is_data(frame, _ESTIMATES.size):
            return None
        turns, turns_s = _ESTIMATES.unpack(frame.data)
        return joint, AxisState(self._node_ids[joint], turns * TURN_RAD, turns_s * TURN_RAD)

    def command_frames(self, torque_nm: Vector, target: Matrix | None = None) -> Sequence[CanFrame]:
        pack = self.mode.layout.pack
        if self.gains is None:
            torques = zip(self._inputs, torque_nm.tolist(), strict=True)
            return [CanFrame(each, pack(torque)) for each, torque in torques]
        turns, turns_s = self._target_or_last(target) / TURN_RAD
        velocities = _words(turns_s * self._scales.input_vel_scale)
        forwards = _words(torque_nm * self._torque_scale)
        rows = zip(self._inputs, turns.tolist(), velocities, forwards, strict=True)
        return [CanFrame(each, pack(*values)) for each, *values in rows]

    def read_torque(self, frame: CanFrame, torque_nm: Vector) -> int | None:
        node_id, command = divmod(frame.identifier, 1 << COMMAND_BITS)
        joint = self._joint_of.get(node_id) if command == self.mode.input else None
        if joint is None or not is_data(frame, self.mode.layout.size):
            return None
        torque_nm[joint] = self.mode.layout.unpack(frame.data)[-1] / self._torque_scale
        return joint


def _words(values: Vector) -> list[int]:
    return [int(each) for each in np.clip(np.rint(values), _WORD.min, _WORD.max).tolist()]

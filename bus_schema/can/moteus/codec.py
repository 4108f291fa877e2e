"""Cyclic frames of moteus controllers, as mjbots' public CAN and register references have them.

The identifier has the receiver in its low byte and the sender in the next one; bit 15 asks for an
answer. A frame holds subframes that write or read neighbouring registers. Positions are turns.

A cycle is, for each drive, a query of mode, position, velocity and fault; the answer; and a command
in position mode, which is not answered. Torques alone are position mode without gains.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.can.frame import CanFrame, is_data
from bus_schema.can.frame_timing import FD_LENGTHS, CycleFrames

TURN_RAD = 2.0 * math.pi
ASKS_REPLY, BROADCAST = 0x8000, 0x7F
NOP = b"\x50"
_MOST_STANDARD = 0x7FF


class Register(IntEnum):
    """The registers that an emulated drive has."""

    MODE = 0x000
    POSITION = 0x001
    VELOCITY = 0x002
    TORQUE = 0x003
    Q_CURRENT = 0x004
    D_CURRENT = 0x005
    MOTOR_TEMPERATURE = 0x00A
    TRAJECTORY_COMPLETE = 0x00B
    VOLTAGE = 0x00D
    TEMPERATURE = 0x00E
    FAULT = 0x00F
    COMMAND_POSITION = 0x020
    COMMAND_VELOCITY = 0x021
    FEEDFORWARD_TORQUE = 0x022
    KP_SCALE = 0x023
    KD_SCALE = 0x024
    MAXIMUM_TORQUE = 0x025
    STOP_POSITION = 0x026
    WATCHDOG_TIMEOUT = 0x027
    VELOCITY_LIMIT = 0x028
    ACCELERATION_LIMIT = 0x029
    SET_OUTPUT_NEAREST = 0x130
    SET_OUTPUT_EXACT = 0x131


class Mode(IntEnum):
    """Register MODE, as far as an emulated drive has them."""

    STOPPED = 0
    FAULT = 1
    POSITION = 10
    TIMEOUT = 11
    ZERO_VELOCITY = 12


_STOP = bytes((0x01, Register.MODE, Mode.STOPPED))  # write one int8
_QUERY = bytes.fromhex("11001e01110f")  # read MODE (int8), POSITION and VELOCITY (float), FAULT
_STATE = struct.Struct("<2sb2sff2sb")
_STATE_HEADS = (b"\x21\x00", b"\x2e\x01", b"\x21\x0f")
_COMMAND = struct.Struct("<6sfffff2sf")
# Write MODE (int8), five floats from COMMAND_POSITION on, and WATCHDOG_TIMEOUT.
_COMMAND_HEAD, _TIMEOUT_HEAD = bytes((0x01, 0x00, Mode.POSITION, 0x0C, 5, 0x20)), b"\x0d\x27"


class MoteusState(NamedTuple):
    """What a drive answers to a query, in turns."""

    mode: int
    position: float
    velocity: float
    fault: int

    @property
    def error(self) -> int:
        """The fault code in mode FAULT, the mode if it is TIMEOUT, else 0."""
        if self.mode == Mode.FAULT:
            return self.fault
        return self.mode if self.mode == Mode.TIMEOUT else 0


def moteus_frame(identifier: int, data: bytes) -> CanFrame:
    """A CAN FD frame, filled up with NOP, with a 29-bit identifier if it needs one."""
    length = next(each for each in FD_LENGTHS if each >= len(data))
    is_extended = identifier > _MOST_STANDARD
    return CanFrame(identifier, data.ljust(length, NOP), is_extended=is_extended, is_fd=True)


def query_frame(node_id: int) -> CanFrame:
    """A frame that asks a drive for its state."""
    return moteus_frame(ASKS_REPLY | node_id, _QUERY)


def state_of(frame: CanFrame) -> tuple[int, MoteusState] | None:
    """Address and state in the answer to a query of master 0; None for any other frame."""
    node_id, receiver = divmod(frame.identifier, 1 << 8)
    if receiver or not is_data(frame._replace(is_extended=False), _STATE.size, is_fd=True):
        return None
    first, mode, second, position, velocity, third, fault = _STATE.unpack(frame.data)
    if (first, second, third) != _STATE_HEADS:
        return None
    return node_id, MoteusState(mode, position, velocity, fault)


class MoteusCodec:
    """Frames of one control cycle, see `CanCodec`.

    Args:
        node_ids: addresses of the drives, one for each joint.
        timeout_s: time after which a command is no longer valid.
        has_gains: drives close their loops around targets.
    """

    def __init__(self, node_ids: Sequence[int], timeout_s: float, *, has_gains: bool) -> None:
        self._node_ids, self._timeout_s, self._has_gains = tuple(node_ids), timeout_s, has_gains
        self._joint_of = {node_id: joint for joint, node_id in enumerate(node_ids)}
        self._sampling = [query_frame(node_id) for node_id in node_ids]
        has_long_answers = max(node_ids) << 8 > _MOST_STANDARD
        self.cycle = CycleFrames(
            (), (len(_QUERY), _STATE.size, _COMMAND.size),
            "{n} × (query 6 bytes + state 16 bytes + command 32 bytes)", is_fd=True,
            extended=1 + has_long_answers,
        )  # fmt: skip

    def sampling_frames(self) -> Sequence[CanFrame]:
        return self._sampling

    def is_sampling(self, frame: CanFrame) -> bool:
        return frame in self._sampling

    def special_frames(self, kind: int) -> Sequence[CanFrame]:  # noqa: ARG002 (one is needed)
        """Frames that stop the drives and ask for their states."""
        return [moteus_frame(ASKS_REPLY | each, _STOP + _QUERY) for each in self._node_ids]

    def stop_frames(self) -> Sequence[CanFrame]:
        """Commands that stop the drives."""
        return [moteus_frame(node_id, _STOP) for node_id in self._node_ids]

    def reply(self, frame: CanFrame) -> tuple[int, MoteusState] | None:
        found = state_of(frame)
        joint = None if found is None else self._joint_of.get(found[0])
        return None if found is None or joint is None else (joint, found[1])

    def read_state(self, frame: CanFrame, position: Vector, velocity: Vector) -> int | None:
        found = self.reply(frame)
        if found is None:
            return None
        joint, state = found
        position[joint], velocity[joint] = state.position * TURN_RAD, state.velocity * TURN_RAD
        return joint

    def command_frames(self, torque_nm: Vector, target: Matrix | None = None) -> Sequence[CanFrame]:
        scale, turns = 0.0, np.full((2, torque_nm.size), np.nan)
        if target is not None and self._has_gains:
            scale, turns = 1.0, target / TURN_RAD
        rows = zip(self._node_ids, *turns.tolist(), torque_nm.tolist(), strict=True)
        return [
            moteus_frame(
                node_id,
                _COMMAND.pack(_COMMAND_HEAD, *row, scale, scale, _TIMEOUT_HEAD, self._timeout_s),
            )
            for node_id, *row in rows
        ]

    def read_torque(self, frame: CanFrame, torque_nm: Vector) -> int | None:
        joint = self._joint_of.get(frame.identifier)
        if joint is None or frame.is_remote or frame.is_error:
            return None
        if frame.data == _STOP:
            torque_nm[joint] = 0.0
        elif len(frame.data) == _COMMAND.size and frame.data.startswith(_COMMAND_HEAD):
            torque_nm[joint] = _COMMAND.unpack(frame.data)[3]
        else:
            return None
        return joint

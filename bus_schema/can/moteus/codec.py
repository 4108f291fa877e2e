"""Frames of moteus controllers, as mjbots' public CAN and register references have them.

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

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.can.codec import AxisState, CanCodec
from bus_schema.can.frame import CanFrame, is_data
from bus_schema.can.frame_timing import FD_LENGTHS, CycleFrames

TURN_RAD = 2.0 * math.pi
ASKS_REPLY, BROADCAST, NOP = 0x8000, 0x7F, b"\x50"
_MOST_STANDARD = 0x7FF
_TURNS, _TURNS_S, _TORQUE = (1e-2, 1e-4, 1e-5), (0.1, 2.5e-4, 1e-5), (0.5, 1e-2, 1e-3)
_FINE, _SHARE = (1.0, 0.1, 1e-3), (1 / 0x7F, 1 / 0x7FFF, 1 / 0x7FFF_FFFF)


class MoteusRegister(IntEnum):
    """The registers that an emulated drive has.

    Attributes:
        steps: of its values where they are integers of 8, 16 and 32 bits.
    """

    steps: tuple[float, float, float]

    def __new__(
        cls, number: int, steps: tuple[float, float, float] = (1.0, 1.0, 1.0)
    ) -> MoteusRegister:
        register = int.__new__(cls, number)
        register._value_, register.steps = number, steps
        return register

    MODE = 0x000
    POSITION = 0x001, _TURNS
    VELOCITY = 0x002, _TURNS_S
    TORQUE = 0x003, _TORQUE
    Q_CURRENT = 0x004, _FINE
    D_CURRENT = 0x005, _FINE
    MOTOR_TEMPERATURE = 0x00A, _FINE
    TRAJECTORY_COMPLETE = 0x00B
    VOLTAGE = 0x00D, (0.5, 0.1, 1e-3)
    TEMPERATURE = 0x00E, _FINE
    FAULT = 0x00F
    COMMAND_POSITION = 0x020, _TURNS
    COMMAND_VELOCITY = 0x021, _TURNS_S
    FEEDFORWARD_TORQUE = 0x022, _TORQUE
    KP_SCALE = 0x023, _SHARE
    KD_SCALE = 0x024, _SHARE
    MAXIMUM_TORQUE = 0x025, _TORQUE
    STOP_POSITION = 0x026, _TURNS
    WATCHDOG_TIMEOUT = 0x027, (1e-2, 1e-3, 1e-6)
    VELOCITY_LIMIT = 0x028, _TURNS_S
    ACCELERATION_LIMIT = 0x029, (0.05, 1e-3, 1e-5)
    SET_OUTPUT_NEAREST = 0x130, _TURNS
    SET_OUTPUT_EXACT = 0x131, _TURNS


class MoteusMode(IntEnum):
    """Register MODE, as far as an emulated drive has them."""

    STOPPED = 0
    FAULT = 1
    POSITION = 10
    TIMEOUT = 11
    ZERO_VELOCITY = 12


_STOP = b"\x01\x00\x00"  # write MODE (int8)
_QUERY = b"\x11\x00\x1e\x01\x11\x0f"  # read MODE (int8), POSITION and VELOCITY (float), FAULT
_STATE, _STATE_HEADS = struct.Struct("<2sb2sff2sb"), (b"\x21\x00", b"\x2e\x01", b"\x21\x0f")
# Write MODE (int8), five floats from COMMAND_POSITION on, and WATCHDOG_TIMEOUT.
_COMMAND = struct.Struct("<6sfffff2sf")
_COMMAND_HEAD, _TIMEOUT_HEAD = b"\x01\x00\x0a\x0c\x05\x20", b"\x0d\x27"


def moteus_frame(identifier: int, data: bytes) -> CanFrame:
    """A CAN FD frame, filled up with NOP, with a 29-bit identifier if it needs one."""
    length = next(each for each in FD_LENGTHS if each >= len(data))
    is_extended = identifier > _MOST_STANDARD
    return CanFrame(identifier, data.ljust(length, NOP), is_extended=is_extended, is_fd=True)


def query_frame(node_id: int, *, stops: bool = False) -> CanFrame:
    """A frame that asks a drive for its state, after a stop if it is to stop."""
    return moteus_frame(ASKS_REPLY | node_id, _STOP + _QUERY if stops else _QUERY)


def state_of(frame: CanFrame) -> AxisState | None:
    """The answer to a query of master 0; None for any other frame.

    Its error is the fault code in mode FAULT, and the mode itself if that is TIMEOUT.
    """
    node_id, receiver = divmod(frame.identifier, 1 << 8)
    if receiver or not is_data(frame._replace(is_extended=False), _STATE.size, is_fd=True):
        return None
    first, mode, second, turns, turns_s, third, fault = _STATE.unpack(frame.data)
    if (first, second, third) != _STATE_HEADS:
        return None
    error = {MoteusMode.FAULT: fault, MoteusMode.TIMEOUT: mode}.get(mode, 0)
    return AxisState(node_id, turns * TURN_RAD, turns_s * TURN_RAD, error=error)


class MoteusCodec(CanCodec):
    """Frames of one control cycle, see `CanCodec`.

    Args:
        node_ids: addresses of the drives, one for each joint.
        timeout_s: time after which a command is no longer valid.
        has_gains: drives close their loops around targets.
    """

    def __init__(self, node_ids: Sequence[int], timeout_s: float, *, has_gains: bool) -> None:
        super().__init__(node_ids, [query_frame(node_id) for node_id in node_ids])
        self._timeout_s, self._has_gains = timeout_s, has_gains
        has_long_answers = max(node_ids) << 8 > _MOST_STANDARD
        self.cycle = CycleFrames(
            (), (len(_QUERY), _STATE.size, _COMMAND.size),
            "{n} × (query 6 bytes + state 16 bytes + command 32 bytes)", is_fd=True,
            extended=1 + has_long_answers,
        )  # fmt: skip

    def stop_frames(self) -> Sequence[CanFrame]:
        """Commands that stop the drives."""
        return [moteus_frame(node_id, _STOP) for node_id in self._node_ids]

    def reply(self, frame: CanFrame) -> tuple[int, AxisState] | None:
        state = state_of(frame)
        if state is None or state.node_id not in self._joint_of:
            return None
        return self._joint_of[state.node_id], state

    def command_frames(self, torque_nm: Vector, target: Matrix | None = None) -> Sequence[CanFrame]:
        scale, turns = 0.0, np.full((2, torque_nm.size), np.nan)
        if target is not None and self._has_gains:
            scale, turns = 1.0, target / TURN_RAD
        rest = scale, scale, _TIMEOUT_HEAD, self._timeout_s
        rows = zip(self._node_ids, *turns.tolist(), torque_nm.tolist(), strict=True)
        return [
            moteus_frame(node_id, _COMMAND.pack(_COMMAND_HEAD, *row, *rest))
            for node_id, *row in rows
        ]

    def read_torque(self, frame: CanFrame, torque_nm: Vector) -> int | None:
        joint = self._joint_of.get(frame.identifier)
        if joint is None or frame.is_remote:
            return None
        if frame.data == _STOP:
            torque_nm[joint] = 0.0
        elif len(frame.data) == _COMMAND.size and frame.data.startswith(_COMMAND_HEAD):
            torque_nm[joint] = _COMMAND.unpack(frame.data)[3]
        else:
            return None
        return joint

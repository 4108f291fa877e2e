"""Frames of Damiao motors, as LeRobot's `DamiaoMotorsBus` and OpenArm's `openarm_can` use them.

Commands in MIT mode are those of the MIT protocol. Feedback has an identifier for each motor
(MST_ID), an error in the high half of its first byte, and two temperatures in °C; so the manual of
the DM-J8009P-2EC, V1.0, section "feedback frame". In the other modes commands go to the motor's
address plus 0x100, 0x200 or 0x300.

A request for the state or a register goes to identifier 0x7FF: address (16 bits), what to do,
register, value. The answer comes at the motor's feedback identifier in the same layout. Registers
have the numbers of `openarm_can`'s RID and of `damiao-motor`'s REGISTER_TABLE.

A motor answers every frame with its state. A cycle is, for each motor, the frame that asks for the
state (0xCC to identifier 0x7FF), the answer, the command, and its answer, which is not used.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

from bus_schema.can.codec import AxisState
from bus_schema.can.frame import CanFrame, is_data
from bus_schema.can.frame_timing import CycleFrames
from bus_schema.can.mit.codec import (
    COMMAND_BYTES,
    MitCodec,
    MitRanges,
    packed_reply,
    reply_of,
)
from bus_schema.drive_feedback import DriveGains

_STATE_BYTES = 6
_NIBBLE = 0xF


class DamiaoMode(IntEnum):
    """Register CTRL_MODE."""

    MIT = 1
    POS_VEL = 2
    VEL = 3
    POS_FORCE = 4

    @property
    def offset(self) -> int:
        """Offset of the identifier of this mode's commands from the motor's address."""
        return (self - 1) << 8


class Status(IntEnum):
    """High half of the first byte of a feedback frame."""

    DISABLED = 0x0
    ENABLED = 0x1
    SENSOR_ERROR = 0x5
    PARAMETER_ERROR = 0x6
    OVER_VOLTAGE = 0x8
    UNDER_VOLTAGE = 0x9
    OVER_CURRENT = 0xA
    MOSFET_HOT = 0xB
    COIL_HOT = 0xC
    LOST_COMMUNICATION = 0xD
    OVERLOAD = 0xE


class Target(NamedTuple):
    """A command in any mode but MIT.

    Attributes:
        position_rad: where the motor is to be; of mode VEL, 0.
        velocity_rad_s: how fast it may go there; of mode VEL, how fast it is to turn.
        torque_share: the torque limit, as a share of the largest torque.
    """

    position_rad: float = 0.0
    velocity_rad_s: float = 0.0
    torque_share: float = 1.0


_PAIR, _SINGLE, _FORCE = struct.Struct("<ff"), struct.Struct("<f"), struct.Struct("<fHH")
_VELOCITY_SCALE, _SHARE_SCALE = 100.0, 10_000.0
_VEL_BYTES = (4, 8)
"""`openarm_can` and the manual send four bytes, other clients fill them up to eight."""


def target_of(mode: DamiaoMode, data: bytes) -> Target | None:
    """Return the command in a frame of a mode other than MIT; None if it is no command."""
    if len(data) not in (_VEL_BYTES if mode is DamiaoMode.VEL else (COMMAND_BYTES,)):
        return None
    if mode is DamiaoMode.VEL:
        target = Target(0.0, *_SINGLE.unpack_from(data))
    elif mode is DamiaoMode.POS_VEL:
        target = Target(*_PAIR.unpack(data))
    else:
        position, speed, share = _FORCE.unpack(data)
        target = Target(position, speed / _VELOCITY_SCALE, min(share / _SHARE_SCALE, 1.0))
    return target if all(map(math.isfinite, target)) else None


def packed_feedback(state: AxisState, ranges: MitRanges, mosfet_c: int) -> bytes:
    """Data of a feedback frame; the state's error is a `Status`, its temperature the rotor's."""
    first = state.error << 4 | state.node_id & _NIBBLE
    packed = packed_reply(state._replace(node_id=first), ranges, _STATE_BYTES)
    return packed + bytes([mosfet_c, state.temperature_c])


def feedback_of(data: bytes, ranges: MitRanges) -> AxisState:
    """State in a feedback frame, see `packed_feedback`."""
    state = reply_of(data[:_STATE_BYTES], ranges)
    return state._replace(
        node_id=data[0] & _NIBBLE, temperature_c=data[COMMAND_BYTES - 1], error=data[0] >> 4
    )


REGISTER_IDENTIFIER = 0x7FF
_HEAD = struct.Struct("<HBB")


class Request(IntEnum):
    """Request in a frame to identifier 0x7FF."""

    READ = 0x33
    WRITE = 0x55
    STORE = 0xAA
    REFRESH = 0xCC


class DamiaoRegister(IntEnum):
    """The registers that an emulated motor acts on, by the vendor's names."""

    MAX_SPD = 6
    MST_ID = 7
    ESC_ID = 8
    TIMEOUT = 9
    CTRL_MODE = 10
    GR = 20
    PMAX = 21
    VMAX = 22
    TMAX = 23
    KP_ASR = 25
    KI_ASR = 26
    KP_APR = 27
    CAN_BR = 35
    P_M = 80
    XOUT = 81


RANGES = {
    DamiaoRegister.PMAX: "position_rad", DamiaoRegister.VMAX: "velocity_rad_s",
    DamiaoRegister.TMAX: "torque_nm",
}  # fmt: skip
"""Registers with the ranges of the numbers in frames, and their names in `MitRanges`."""

TIMEOUT_STEP_NS = 50_000
"""Unit of register TIMEOUT."""

_WHOLE = {*range(7, 11), *range(13, 17), 35, 36}
"""Registers that hold a number of 32 bits; all others hold a float."""


class RegisterFrame(NamedTuple):
    """A request to a motor, or its answer.

    Attributes:
        node_id: address of the motor.
        request: what is asked for; perhaps no `Request`.
        register: its number.
        value: what is written, or was read.
    """

    node_id: int
    request: int
    register: int = 0
    value: float = 0.0

    def packed(self) -> bytes:
        """The eight bytes."""
        form = "<I" if self.register in _WHOLE else "<f"
        value = int(self.value) if self.register in _WHOLE else self.value
        return _HEAD.pack(*self[:3]) + struct.pack(form, value)


def register_frame(data: bytes) -> RegisterFrame:
    """Return the request or answer in eight bytes."""
    node_id, request, register = _HEAD.unpack_from(data)
    form = "<I" if register in _WHOLE else "<f"
    (value,) = struct.unpack_from(form, data, _HEAD.size)
    return RegisterFrame(node_id, request, register, value)


class DamiaoCodec(MitCodec):
    """Frames of one control cycle in MIT mode, see `CanCodec`.

    Args:
        node_ids: addresses of the motors (ESC_ID), one for each joint.
        ranges: of the numbers of each motor.
        feedback_ids: identifiers of their frames (MST_ID).
        is_fd: all frames are those of CAN FD.
        gains: of the loops that motors close around targets; None for torques alone.
    """

    def __init__(
        self,
        node_ids: Sequence[int],
        ranges: Sequence[MitRanges],
        feedback_ids: Sequence[int],
        *,
        is_fd: bool,
        gains: DriveGains | None = None,
    ) -> None:
        self.is_fd = is_fd
        super().__init__(node_ids, ranges, 0, COMMAND_BYTES, gains)
        self._joint_at = {each: joint for joint, each in enumerate(feedback_ids)}
        self._sampling = [
            self.frame(REGISTER_IDENTIFIER, RegisterFrame(node_id, Request.REFRESH).packed())
            for node_id in node_ids
        ]
        self.cycle = CycleFrames(
            (), 4 * (COMMAND_BYTES,),
            "{n} × (request + command + 2 states, 8 bytes each)", is_fd=is_fd,
        )  # fmt: skip

    def reply(self, frame: CanFrame) -> tuple[int, AxisState] | None:
        joint = self._joint_at.get(frame.identifier)
        if joint is None or not is_data(frame, COMMAND_BYTES, is_fd=self.is_fd):
            return None
        return joint, feedback_of(frame.data, self.ranges[joint])

"""Registers of Damiao motors, and the frames that read, write and store them.

A request goes to identifier 0x7FF: address (16 bits), what to do, register, value. The answer comes
at the motor's feedback identifier in the same layout. Registers have the numbers of `openarm_can`'s
RID and of `damiao-motor`'s REGISTER_TABLE.
"""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import NamedTuple

REGISTER_IDENTIFIER = 0x7FF
_HEAD = struct.Struct("<HBB")


class Request(IntEnum):
    """What a frame to identifier 0x7FF asks for."""

    READ = 0x33
    WRITE = 0x55
    STORE = 0xAA
    REFRESH = 0xCC


class Register(IntEnum):
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
    Register.PMAX: "position_rad", Register.VMAX: "velocity_rad_s", Register.TMAX: "torque_nm"
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
    """What eight bytes say."""
    node_id, request, register = _HEAD.unpack_from(data)
    form = "<I" if register in _WHOLE else "<f"
    (value,) = struct.unpack_from(form, data, _HEAD.size)
    return RegisterFrame(node_id, request, register, value)

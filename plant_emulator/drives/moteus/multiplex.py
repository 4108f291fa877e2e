"""Subframes of moteus' frames, as its public CAN reference has them, and how numbers are written.

Numbers are floats, or integers of 8, 16 or 32 bits in steps of their register's unit; the lowest
integer stands for NaN, and what is beyond the others becomes the nearest of them.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from enum import IntEnum
from typing import NamedTuple

from bus_schema.can.moteus.codec import NOP, Register
from bus_schema.errors import InvalidMessageError

_FORMATS, _FLOAT = "bhif", 3
_MOST = (0x7F, 0x7FFF, 0x7FFF_FFFF)
_MOST_REGISTERS, _MOST_SHORT = 64, 3
_POSITION, _VELOCITY, _TORQUE = (1e-2, 1e-4, 1e-5), (0.1, 2.5e-4, 1e-5), (0.5, 1e-2, 1e-3)
_CURRENT = _TEMPERATURE = (1.0, 0.1, 1e-3)
_SHARE = (1 / _MOST[0], 1 / _MOST[1], 1 / _MOST[2])
_STEPS: dict[int, tuple[float, float, float]] = {
    Register.POSITION: _POSITION, Register.VELOCITY: _VELOCITY, Register.TORQUE: _TORQUE,
    Register.Q_CURRENT: _CURRENT, Register.D_CURRENT: _CURRENT,
    Register.MOTOR_TEMPERATURE: _TEMPERATURE, Register.TEMPERATURE: _TEMPERATURE,
    Register.VOLTAGE: (0.5, 0.1, 1e-3),
    Register.COMMAND_POSITION: _POSITION, Register.COMMAND_VELOCITY: _VELOCITY,
    Register.FEEDFORWARD_TORQUE: _TORQUE, Register.MAXIMUM_TORQUE: _TORQUE,
    Register.KP_SCALE: _SHARE, Register.KD_SCALE: _SHARE, Register.STOP_POSITION: _POSITION,
    Register.WATCHDOG_TIMEOUT: (1e-2, 1e-3, 1e-6), Register.VELOCITY_LIMIT: _VELOCITY,
    Register.ACCELERATION_LIMIT: (0.05, 1e-3, 1e-5),
    Register.SET_OUTPUT_NEAREST: _POSITION, Register.SET_OUTPUT_EXACT: _POSITION,
}  # fmt: skip
"""Steps of integers of 8, 16 and 32 bits; 1 where there is none."""

_WHOLE = (1.0, 1.0, 1.0)


class Operation(IntEnum):
    """High half of a subframe's first byte."""

    WRITE = 0x00
    READ = 0x10
    REPLY = 0x20


class ErrorKind(IntEnum):
    """First byte of a subframe that names a register which a drive does not have."""

    WRITE = 0x30
    READ = 0x31

    def packed(self, register: int) -> bytes:
        """The subframe."""
        return bytes((self, *_packed_varuint(register), _UNKNOWN_REGISTER))


_UNKNOWN_REGISTER = 1


class Subframe(NamedTuple):
    """Neighbouring registers that are written, read or reported.

    Attributes:
        operation: what is done with them.
        form: how numbers are written, 0 to 2 for integers and 3 for floats.
        registers: their numbers.
        values: those that are written or reported.
    """

    operation: Operation
    form: int
    registers: range
    values: tuple[float, ...] = ()

    def packed_reply(self, known: Mapping[int, float]) -> bytes:
        """The reply to a reading subframe, all of whose registers are known."""
        count, form = len(self.registers), self.form
        numbers = (_number(each, known[each], form) for each in self.registers)
        short = count if count <= _MOST_SHORT else 0
        head = bytes((Operation.REPLY | form << 2 | short,)) + (b"" if short else bytes((count,)))
        return (
            head + _packed_varuint(self.registers.start)
            + struct.pack(f"<{count}{_FORMATS[form]}", *numbers)
        )  # fmt: skip


def subframes(data: bytes) -> list[Subframe]:
    """The subframes of a frame.

    Raises:
        InvalidMessageError: it ends early, or has a subframe that is none of `Operation`.
    """
    found, place = [], 0
    while place < len(data):
        kind, place = data[place], place + 1
        if kind == NOP[0]:
            continue
        operation, form, count = kind & 0xF0, kind >> 2 & 3, kind & 3
        if operation not in list(Operation):
            raise InvalidMessageError("no_subframe", f"drives have no use for {kind:#x}")
        if not count:
            count, place = _varuint(data, place)
        start, place = _varuint(data, place)
        if count > _MOST_REGISTERS:
            raise InvalidMessageError("too_short", f"no frame has {count} registers")
        registers = range(start, start + count)
        layout = struct.Struct("<" + (operation != Operation.READ) * count * _FORMATS[form])
        raw, place = data[place : place + layout.size], place + layout.size
        if len(raw) < layout.size:
            raise InvalidMessageError("too_short", f"{data.hex()} ends early")
        rows = zip(registers, layout.unpack(raw), strict=False)
        values = tuple(_value(register, number, form) for register, number in rows)
        found.append(Subframe(Operation(operation), form, registers, values))
    return found


def _value(register: int, number: float, form: int) -> float:
    if form == _FLOAT:
        return number
    return math.nan if number < -_MOST[form] else number * _STEPS.get(register, _WHOLE)[form]


def _number(register: int, value: float, form: int) -> float:
    if form == _FLOAT:
        return value
    if math.isnan(value):
        return -_MOST[form] - 1
    steps = value / _STEPS.get(register, _WHOLE)[form]
    return int(min(max(steps, -_MOST[form]), _MOST[form]))


def _varuint(data: bytes, place: int) -> tuple[int, int]:
    """A number in groups of 7 bits, the lowest first, and where what follows it begins."""
    number = 0
    for index, byte in enumerate(data[place : place + 5]):
        number |= (byte & 0x7F) << 7 * index
        if not byte & 0x80:
            return number, place + index + 1
    raise InvalidMessageError("too_short", f"{data.hex()} ends early")


def _packed_varuint(number: int) -> bytes:
    low, rest = number & 0x7F, number >> 7
    return bytes((low | 0x80,)) + _packed_varuint(rest) if rest else bytes((low,))

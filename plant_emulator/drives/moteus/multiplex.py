"""Subframes of moteus' frames, as its public CAN reference has them, and how numbers are written.

Numbers are floats, or integers of 8, 16 or 32 bits in steps of their register's unit; the lowest
integer stands for NaN, and what is beyond the others becomes the nearest of them.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Mapping
from enum import IntEnum
from typing import NamedTuple

from bus_schema.can.moteus.codec import NOP, MoteusRegister
from bus_schema.errors import InvalidMessageError

_FORMATS, _FLOAT = "bhif", 3
_MOST = (0x7F, 0x7FFF, 0x7FFF_FFFF)
_STEPS = {int(register): register.steps for register in MoteusRegister}
_WHOLE = (1.0, 1.0, 1.0)
_MOST_REGISTERS, _MOST_SHORT, _MOST_VARUINT = 64, 3, 5


class Operation(IntEnum):
    """High half of a subframe's first byte."""

    WRITE = 0x00
    READ = 0x10
    REPLY = 0x20


WRITE_ERROR, READ_ERROR, _UNKNOWN_REGISTER = 0x30, 0x31, 1


class Subframe(NamedTuple):
    """Neighbouring registers that are written, read or reported.

    Attributes:
        operation: what is done with them.
        form: how numbers are written: 0 to 2 for integers, 3 for floats.
        registers: their numbers.
        values: those that are written or reported.
    """

    operation: int
    form: int
    registers: range
    values: tuple[float, ...]


def subframes(data: bytes) -> list[Subframe]:
    """The subframes of a frame.

    Raises:
        InvalidMessageError: it ends early, or has a subframe that is none of `Operation`.
    """
    found = []
    while data := data.lstrip(NOP):
        kind, data = data[0], data[1:]
        operation, form, count = kind & 0xF0, kind >> 2 & 3, kind & 3
        if operation not in list(Operation):
            raise InvalidMessageError("no_subframe", f"drives have no use for {kind:#x}")
        if not count:
            count, data = _split_varuint(data)
        start, data = _split_varuint(data)
        layout = "<" + _FORMATS[form]
        size = count * struct.calcsize(layout) if operation != Operation.READ else 0
        if len(data) < size or count > _MOST_REGISTERS:
            raise InvalidMessageError("too_short", f"{count} registers are announced")
        registers = range(start, start + count)
        numbers = (number for (number,) in struct.iter_unpack(layout, data[:size]))
        rows = zip(registers, numbers, strict=False)
        values = tuple(_value(register, number, form) for register, number in rows)
        found.append(Subframe(operation, form, registers, values))
        data = data[size:]
    return found


def packed_reply(asked: Iterable[Subframe], known: Mapping[int, float]) -> bytes:
    """Replies to reading subframes, up to one with a register that is not known."""
    data = b""
    for _, form, registers, _ in asked:
        unknown = next((register for register in registers if register not in known), None)
        if unknown is not None:
            return data + packed_error(READ_ERROR, unknown)
        count = len(registers)
        is_short = count <= _MOST_SHORT
        head = Operation.REPLY | form << 2 | (count if is_short else 0)
        numbers = (_number(register, known[register], form) for register in registers)
        data += bytes((head, *(() if is_short else (count,)))) + _varuint(registers.start)
        data += struct.pack(f"<{count}{_FORMATS[form]}", *numbers)
    return data


def packed_error(kind: int, register: int) -> bytes:
    """A subframe that says that there is no such register to read or write."""
    return bytes((kind, *_varuint(register), _UNKNOWN_REGISTER))


def _value(register: int, number: float, form: int) -> float:
    if form == _FLOAT:
        return number
    return math.nan if number < -_MOST[form] else number * _STEPS.get(register, _WHOLE)[form]


def _number(register: int, value: float, form: int) -> float:
    if form == _FLOAT:
        return value
    if math.isnan(value):
        return -_MOST[form] - 1
    steps = value / _STEPS[register][form]
    return int(min(max(steps, -_MOST[form]), _MOST[form]))


def _split_varuint(data: bytes) -> tuple[int, bytes]:
    """A number in groups of 7 bits, the lowest first, and what follows it."""
    number = 0
    for index, byte in enumerate(data[:_MOST_VARUINT]):
        number |= (byte & 0x7F) << 7 * index
        if not byte & 0x80:
            return number, data[index + 1 :]
    raise InvalidMessageError("too_short", "the frame ends within a number")


def _varuint(number: int) -> bytes:
    low, rest = number & 0x7F, number >> 7
    return bytes((low | 0x80,)) + _varuint(rest) if rest else bytes((low,))

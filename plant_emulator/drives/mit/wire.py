"""What the bytes of the MIT protocol mean: mini-cheetah's public firmware and CubeMars' AK manual.

A number is an unsigned integer of 16 or 12 bits over a range that both sides must agree on. It is
cut off, not rounded, as the firmware does: what arrives is up to one step lower than what was sent,
and zero itself is no step of a range around it.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

from bus_schema.can.frame import CanFrame, is_classical_data

_LONG, _SHORT = 16, 12
_SPECIAL = b"\xff" * 7
COMMAND_BYTES = 8
REPLY_BYTES = (6, 8)
"""Without and with temperature and error."""

_COLDEST_C = -40
_BYTE = 0xFF


class Special(IntEnum):
    """Last byte of the frames that are no commands."""

    ENTER = 0xFC
    EXIT = 0xFD
    ZERO = 0xFE


class DriveError(IntEnum):
    """The error byte of a reply, as far as an emulated drive sends it."""

    NONE = 0
    OVER_TEMPERATURE = 1
    OVER_CURRENT = 2


class MitRanges(NamedTuple):
    """The ranges of one drive's numbers; the first three reach from minus to plus."""

    position_rad: float = 12.5
    velocity_rad_s: float = 50.0
    torque_nm: float = 18.0
    stiffness_nm_rad: float = 500.0
    damping_nm_s: float = 5.0


class Command(NamedTuple):
    """What a drive is to do: torque + stiffness (position - q) + damping (velocity - q')."""

    position_rad: float = 0.0
    velocity_rad_s: float = 0.0
    stiffness_nm_rad: float = 0.0
    damping_nm_s: float = 0.0
    torque_nm: float = 0.0


class Reply(NamedTuple):
    """What a drive answers to every frame; the last two are those of newer firmware."""

    node_id: int
    position_rad: float
    velocity_rad_s: float
    torque_nm: float
    temperature_c: int = 0
    error: int = DriveError.NONE


def special(kind: Special) -> bytes:
    """Data of a frame that enters or leaves motor mode, or makes the position zero."""
    return _SPECIAL + bytes([kind])


def special_of(data: bytes) -> Special | None:
    """Which frame it is, None for a command."""
    if data[:-1] != _SPECIAL or data[-1] not in Special._value2member_map_:
        return None
    return Special(data[-1])


def packed_command(command: Command, ranges: MitRanges) -> bytes:
    """The eight bytes of a command; what is beyond its range is at its end."""
    position, velocity, stiffness, damping, torque = command
    return (
        _signed(position, ranges.position_rad, _LONG) << 48
        | _signed(velocity, ranges.velocity_rad_s, _SHORT) << 36
        | _steps(stiffness, ranges.stiffness_nm_rad, _SHORT) << 24
        | _steps(damping, ranges.damping_nm_s, _SHORT) << 12
        | _signed(torque, ranges.torque_nm, _SHORT)
    ).to_bytes(COMMAND_BYTES, "big")


def command_of(data: bytes, ranges: MitRanges) -> Command:
    """What eight bytes that are not `special_of` command."""
    bits = int.from_bytes(data, "big")
    return Command(
        _number(bits >> 48, ranges.position_rad, _LONG),
        _number(bits >> 36, ranges.velocity_rad_s, _SHORT),
        _share(bits >> 24, _SHORT) * ranges.stiffness_nm_rad,
        _share(bits >> 12, _SHORT) * ranges.damping_nm_s,
        _number(bits, ranges.torque_nm, _SHORT),
    )


def packed_reply(reply: Reply, ranges: MitRanges, reply_bytes: int) -> bytes:
    """The bytes of a reply, as many as the firmware sends."""
    state = (
        (reply.node_id & _BYTE) << 40
        | _signed(reply.position_rad, ranges.position_rad, _LONG) << 24
        | _signed(reply.velocity_rad_s, ranges.velocity_rad_s, _SHORT) << 12
        | _signed(reply.torque_nm, ranges.torque_nm, _SHORT)
    ).to_bytes(REPLY_BYTES[0], "big")
    return (state + bytes([reply.temperature_c - _COLDEST_C, reply.error]))[:reply_bytes]


def reply_of(data: bytes, ranges: MitRanges) -> Reply:
    """What six or eight bytes report."""
    bits = int.from_bytes(data[: REPLY_BYTES[0]], "big")
    reply = Reply(
        data[0],
        _number(bits >> 24, ranges.position_rad, _LONG),
        _number(bits >> 12, ranges.velocity_rad_s, _SHORT),
        _number(bits, ranges.torque_nm, _SHORT),
    )
    if len(data) == REPLY_BYTES[0]:
        return reply
    return reply._replace(temperature_c=data[6] + _COLDEST_C, error=data[7])


def is_command(frame: CanFrame) -> bool:
    """Whether a frame has the form of a command or a special one."""
    return is_classical_data(frame, COMMAND_BYTES)


def is_reply(frame: CanFrame) -> bool:
    """Whether a frame has the form of a reply."""
    return any(is_classical_data(frame, length) for length in REPLY_BYTES)


def _signed(value: float, limit: float, bits: int) -> int:
    return _steps(value + limit, 2.0 * limit, bits)


def _steps(value: float, span: float, bits: int) -> int:
    most = (1 << bits) - 1
    return int(min(max(value / span, 0.0), 1.0) * most)


def _share(bits: int, length: int) -> float:
    most = (1 << length) - 1
    return (bits & most) / most


def _number(bits: int, limit: float, length: int) -> float:
    return (2.0 * _share(bits, length) - 1.0) * limit

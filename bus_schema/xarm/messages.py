"""Messages of xArm: commands (port 502) and reports (30001 to 30003), after UFACTORY's own client.

A command is its number, 2 or 3 for the protocol, the length of the rest (16 bits each, big-endian),
a function and a payload. An answer repeats the number, protocol and function, followed by a state.
Numbers in payloads are big-endian, but floats are little-endian.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from enum import IntEnum
from typing import NamedTuple

_HEADER = struct.Struct(">3H")
_MOST_BYTES = 1024
_PROTOCOLS = (2, 3)
JOINTS = 7
"""Number of joints in messages; those that an arm does not have are 0."""
_LIMITS = (1e4, 1.0, 5e4, 0.1, 1e3, 349.0, 0.01, 20.0, 0.01, 3.14, 40.0, 20.0)
"""Jerk, least and largest acceleration and speed of the tool (mm) and of joints (rad), rotation."""
NOT_READY, INVALID = 0x10, 0x08
"""Bits of the state in an answer."""
SERVO_TARGET = struct.Struct(f"<{JOINTS + 3}f")
"""Payload: positions in rad, then speed, acceleration and time, which have no effect."""


class Function(IntEnum):
    """Functions of commands that are emulated."""

    GET_VERSION = 1
    GET_SERIAL_NUMBER = 2
    ENABLE = 11
    SET_STATE = 12
    GET_STATE = 13
    GET_COMMANDS = 14
    GET_ERROR = 15
    CLEAR_ERROR = 16
    CLEAR_WARNING = 17
    SET_MODE = 19
    SERVO_JOINTS = 29
    GET_JOINTS = 42


class Command(NamedTuple):
    """A command that has arrived.

    Attributes:
        head: its number and protocol, as bytes.
        function: its kind, perhaps an unknown one.
        payload: the rest.
    """

    head: bytes
    function: int
    payload: bytes


class CommandReader:
    """Collects bytes of a connection, and returns whole commands."""

    def __init__(self) -> None:
        self._bytes = b""

    def take(self, data: bytes) -> Iterator[Command]:
        """Return the commands that are complete; messages of other protocols are left out.

        Raises:
            ValueError: the bytes are no commands.
        """
        self._bytes += data
        while len(self._bytes) >= _HEADER.size:
            _, protocol, length = _HEADER.unpack_from(self._bytes)
            if not 1 <= length <= _MOST_BYTES:
                raise ValueError(f"a command of {length} bytes: must have 1 to {_MOST_BYTES}")
            end = _HEADER.size + length
            if len(self._bytes) < end:
                return
            message, self._bytes = self._bytes[:end], self._bytes[end:]
            if protocol in _PROTOCOLS:  # others are signs of life
                yield Command(message[:4], message[_HEADER.size], message[_HEADER.size + 1 :])


def answer(command: Command, state: int, payload: bytes = b"") -> bytes:
    """Return the answer to a command."""
    rest = bytes([command.function, state]) + payload
    return command.head + struct.pack(">H", len(rest)) + rest


def floats(values: Sequence[float]) -> bytes:
    """Return values as a payload."""
    return struct.pack(f"<{len(values)}f", *values)


def text(words: str) -> bytes:
    """Return a text of 40 bytes."""
    return words.encode("ascii")[:39].ljust(40, b"\0")


class Detail(IntEnum):
    """Amount of detail in a report."""

    SHORT = 0
    NORMAL = 1
    RICH = 2


def report(
    state: int, mode: int, position_rad: Sequence[float], torque_nm: Sequence[float], axes: int, *,
    enabled: bool, detail: Detail,
) -> bytes:  # fmt: skip
    """Return a report; poses, offsets and loads are 0.

    Args:
        state: 1 moves, 2 is ready, 3 pauses, 4 is stopped.
        mode: 0 for positions, 1 for servo motion.
        position_rad: of seven joints.
        torque_nm: likewise.
        axes: number of joints that the arm has.
        enabled: whether the motors are.
        detail: port 30003 has short ones, 30001 normal ones, 30002 rich ones.
    """
    body = bytes([mode << 4 | state]) + bytes(2)
    body += floats([*position_rad, *6 * [0.0], *torque_nm])
    if detail >= Detail.NORMAL:
        motors = 0x7F * enabled
        body += bytes([motors, motors, 0, 0]) + bytes(42) + floats([0.0, 0.0, -9.8])
    if detail >= Detail.RICH:
        body += bytes([axes, axes, 0, 0, 0, 0]) + bytes(30) + floats(_LIMITS) + bytes(16)
    return struct.pack(">I", len(body) + 4) + body

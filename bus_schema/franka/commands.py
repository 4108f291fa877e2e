"""Commands of the research interface over TCP, after libfranka's public headers.

A message is a header (command, its number, size in bytes; 32 bits each) and a payload. All numbers
are little-endian, without padding. Answers repeat command and number, and begin with a status.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from enum import IntEnum
from typing import NamedTuple

VERSION = 10
PORT = 1337
_HEADER = struct.Struct("<3I")
_MOST_BYTES = 1 << 12


class Command(IntEnum):
    """Numbers of commands."""

    CONNECT = 0
    MOVE = 1
    STOP_MOVE = 2
    SET_COLLISION_BEHAVIOR = 3
    SET_JOINT_IMPEDANCE = 4
    SET_CARTESIAN_IMPEDANCE = 5
    SET_GUIDING_MODE = 6
    SET_EE_TO_K = 7
    SET_NE_TO_EE = 8
    SET_LOAD = 9
    AUTOMATIC_ERROR_RECOVERY = 10
    GET_ROBOT_MODEL = 11


class MoveStatus(IntEnum):
    """Statuses of answers to `Command.MOVE` that are used."""

    SUCCESS = 0
    STARTED = 1
    PREEMPTED = 2
    NOT_POSSIBLE = 5
    INVALID_ARGUMENT = 7
    REFLEX_ABORTED = 8


SUCCESS, NOT_POSSIBLE, INVALID_ARGUMENT, INCOMPATIBLE = 0, 1, 2, 1
CONNECT, MOVE = struct.Struct("<2H"), struct.Struct("<2I6d")
"""Payloads: version and UDP port; modes of controller and motion generator, and deviations.

A move may have settings of an asynchronous motion behind, which are 0 for others.
"""
SETTINGS: Mapping[int, struct.Struct] = {
    Command.SET_COLLISION_BEHAVIOR: struct.Struct("<52d"),
    Command.SET_JOINT_IMPEDANCE: struct.Struct("<7d"),
    Command.SET_CARTESIAN_IMPEDANCE: struct.Struct("<6d"),
    Command.SET_EE_TO_K: struct.Struct("<16d"),
    Command.SET_NE_TO_EE: struct.Struct("<16d"),
    Command.SET_LOAD: struct.Struct("<13d"),
}
"""Payloads of commands that set something."""


class Request(NamedTuple):
    """A command that has arrived.

    Attributes:
        command: its kind, perhaps an unknown one.
        number: which its answers repeat.
        payload: the rest.
    """

    command: int
    number: int
    payload: bytes


def answer(request: Request, status: int, rest: bytes = b"") -> bytes:
    """Return an answer to a command."""
    payload = bytes([status]) + rest
    size = _HEADER.size + len(payload)
    return _HEADER.pack(request.command, request.number, size) + payload


class RequestReader:
    """Collects bytes of a connection, and returns whole commands."""

    def __init__(self) -> None:
        self._bytes = b""

    def take(self, data: bytes) -> Iterator[Request]:
        """Return the commands that are complete.

        Raises:
            ValueError: the bytes are no commands.
        """
        self._bytes += data
        while len(self._bytes) >= _HEADER.size:
            command, number, size = _HEADER.unpack_from(self._bytes)
            if not _HEADER.size <= size <= _MOST_BYTES:
                raise ValueError(
                    f"a command of {size} bytes: must have {_HEADER.size} to {_MOST_BYTES}"
                )
            if len(self._bytes) < size:
                return
            payload, self._bytes = self._bytes[_HEADER.size : size], self._bytes[size:]
            yield Request(command, number, payload)

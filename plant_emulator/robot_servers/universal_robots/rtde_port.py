"""A client of the RTDE port: its handshake, its recipes, and its data."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping

from bus_schema.rtde.packages import Kind, PackageReader, Recipe, Value, package
from plant_emulator.robot_servers.universal_robots.variables import type_of, zero_of

VERSION = (5, 11, 0, 0)
"""Version of the controller's software that clients receive."""
_PROTOCOL = 2
_NOT_FOUND = "NOT_FOUND"


class RtdeClient:
    """One connection.

    Args:
        send: sends bytes to it; returns whether the connection is still open.
        take: takes the input registers of a package.
    """

    def __init__(
        self, send: Callable[[bytes], bool], take: Callable[[Mapping[str, Value]], None]
    ) -> None:
        self._send, self._take = send, take
        self._reader = PackageReader()
        self._inputs: dict[int, Recipe] = {}
        self._outputs: Recipe | None = None
        self._zeros: dict[str, Value] = {}
        self._period_s, self._next_s, self._is_started = 0.002, 0.0, False

    def receive(self, data: bytes) -> None:
        """Answer what has arrived.

        Raises:
            ValueError: it is not RTDE.
        """
        for kind, payload in self._reader.take(data):
            if kind == Kind.DATA:
                recipe = self._inputs.get(payload[0]) if payload else None
                if recipe is not None:
                    self._take(recipe.unpack(payload))
            elif kind in self._ANSWERS:
                answer = self._ANSWERS[Kind(kind)](self, payload)
                if not self._send(package(Kind(kind), answer)):
                    return

    def publish(self, now_s: float, values: Mapping[str, Value]) -> None:
        """Send the variables that it asked for, if they are due."""
        if self._outputs is None or not self._is_started or now_s < self._next_s - 1e-6:
            return
        self._next_s = max(self._next_s + self._period_s, now_s)
        self._send(package(Kind.DATA, self._outputs.pack({**self._zeros, **values})))

    def _version(self, payload: bytes) -> bytes:
        return bytes([payload == struct.pack(">H", _PROTOCOL)])

    def _controller(self, _: bytes) -> bytes:
        return struct.pack(">4I", *VERSION)

    def _set_outputs(self, payload: bytes) -> bytes:
        (frequency_hz,) = struct.unpack_from(">d", payload)
        if not math.isfinite(frequency_hz):
            raise ValueError(f"an output frequency of {frequency_hz} Hz: must be finite")
        types = _types_of(payload[8:])
        if None in types.values():
            return bytes(1) + _answered(types)
        known = {name: kind for name, kind in types.items() if kind is not None}
        self._outputs, self._period_s = Recipe(1, known), 1.0 / min(max(frequency_hz, 1.0), 500.0)
        self._zeros = {name: zero_of(kind) for name, kind in known.items()}
        return bytes([1]) + _answered(types)

    def _set_inputs(self, payload: bytes) -> bytes:
        types = _types_of(payload)
        number = len(self._inputs) + 1
        if None in types.values():
            return bytes(1) + _answered(types)
        self._inputs[number] = Recipe(number, {n: k for n, k in types.items() if k is not None})
        return bytes([number]) + _answered(types)

    def _start(self, _: bytes) -> bytes:
        self._is_started = True
        return bytes([1])

    def _pause(self, _: bytes) -> bytes:
        self._is_started = False
        return bytes([1])

    _ANSWERS: Mapping[Kind, Callable[[RtdeClient, bytes], bytes]] = {
        Kind.PROTOCOL_VERSION: _version, Kind.CONTROLLER_VERSION: _controller,
        Kind.OUTPUTS: _set_outputs, Kind.INPUTS: _set_inputs, Kind.START: _start,
        Kind.PAUSE: _pause,
    }  # fmt: skip


def _types_of(names: bytes) -> dict[str, str | None]:
    text = names.decode("ascii", "replace")
    return {name: type_of(name) for name in text.split(",") if name}


def _answered(types: Mapping[str, str | None]) -> bytes:
    return ",".join(kind or _NOT_FOUND for kind in types.values()).encode()

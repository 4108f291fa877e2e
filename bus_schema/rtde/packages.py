"""Packages of RTDE, protocol 2, after Universal Robots' public guide.

A package is its size (two bytes, big-endian), its kind (one), and a payload.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from enum import IntEnum

Value = float | int | bool | Sequence[float] | Sequence[int]

_HEADER = struct.Struct(">HB")
_MOST_BYTES = 1 << 16


class Kind(IntEnum):
    """Kinds of packages."""

    PROTOCOL_VERSION = ord("V")
    CONTROLLER_VERSION = ord("v")
    TEXT = ord("M")
    DATA = ord("U")
    OUTPUTS = ord("O")
    INPUTS = ord("I")
    START = ord("S")
    PAUSE = ord("P")


FORMATS = {
    "BOOL": "?", "UINT8": "B", "UINT32": "I", "UINT64": "Q", "INT32": "i", "DOUBLE": "d",
    "VECTOR3D": "3d", "VECTOR6D": "6d", "VECTOR6INT32": "6i", "VECTOR6UINT32": "6I",
}  # fmt: skip
"""Of `struct`, by name of the type."""


def package(kind: Kind, payload: bytes = b"") -> bytes:
    """Return a package as bytes."""
    return _HEADER.pack(_HEADER.size + len(payload), kind) + payload


class PackageReader:
    """Collects bytes of a stream, and returns whole packages."""

    def __init__(self) -> None:
        self._bytes = b""

    def take(self, data: bytes) -> Iterator[tuple[int, bytes]]:
        """Return the kind and the payload of each package that is complete.

        Raises:
            ValueError: the bytes are no packages.
        """
        self._bytes += data
        while len(self._bytes) >= _HEADER.size:
            size, kind = _HEADER.unpack_from(self._bytes)
            if not _HEADER.size <= size < _MOST_BYTES:
                raise ValueError(f"a package of {size} bytes: must have at least {_HEADER.size}")
            if len(self._bytes) < size:
                return
            payload, self._bytes = self._bytes[_HEADER.size : size], self._bytes[size:]
            yield kind, payload


class Recipe:
    """Variables of a data package, in order.

    Args:
        number: of the recipe.
        types: of the variables, by name.

    Raises:
        ValueError: a type is unknown.
    """

    def __init__(self, number: int, types: Mapping[str, str]) -> None:
        unknown = [name for name, kind in types.items() if kind not in FORMATS]
        if unknown:
            raise ValueError(f"{', '.join(unknown)}: must be one of {', '.join(FORMATS)}")
        self.number, self.names = number, list(types)
        self._sizes = [
            struct.calcsize(">" + FORMATS[kind]) // struct.calcsize(">" + FORMATS[kind][-1])
            for kind in types.values()
        ]
        self._struct = struct.Struct(">B" + "".join(FORMATS[kind] for kind in types.values()))

    def pack(self, values: Mapping[str, Value]) -> bytes:
        """Return a payload with these values."""
        flat: list[Value] = []
        for name, size in zip(self.names, self._sizes, strict=True):
            value = values[name]
            flat += [value] if size == 1 else list(value)  # type: ignore[arg-type]
        return self._struct.pack(self.number, *flat)

    def unpack(self, payload: bytes) -> dict[str, Value]:
        """Return the values of a payload, by name.

        Raises:
            ValueError: it has another size.
        """
        if len(payload) != self._struct.size:
            raise ValueError(f"{len(payload)} bytes: must be {self._struct.size} of this recipe")
        _, *flat = self._struct.unpack(payload)
        found: dict[str, Value] = {}
        for name, size in zip(self.names, self._sizes, strict=True):
            values, flat = flat[:size], flat[size:]
            found[name] = values[0] if size == 1 else values
        return found

"""Messages filled with zeros, whose bytes show where each field lies."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype

from bus_schema.messages.types import TYPESTORE


def zero_message(
    type_name: str, lengths: Mapping[str, int], strings: Mapping[str, list[str]], prefix: str = ""
) -> Any:
    """Return a message of a type with arrays of these lengths, all zero, and these strings.

    Its numbers are NumPy scalars of the type that they have on the wire.
    """
    values: dict[str, Any] = {}
    fields: Any = TYPESTORE.fielddefs[type_name][1]
    for field, (kind, argument) in fields:
        path = prefix + field
        if kind == Nodetype.NAME:
            values[field] = zero_message(argument, lengths, strings, path + ".")
        elif kind == Nodetype.BASE:
            values[field] = "" if argument[0] == "string" else _numpy_type(argument[0]).type(0)
        elif argument[0][1][0] == "string":
            values[field] = strings.get(path, [])
        else:
            length = lengths[path] if kind == Nodetype.SEQUENCE else argument[1]
            values[field] = np.zeros(length, _numpy_type(argument[0][1][0]))
    return TYPESTORE.types[type_name](**values)


def numeric_fields(message: Any, prefix: str = "") -> Iterator[tuple[str, np.dtype[Any], Any, str]]:
    """Yield each number and array of a `zero_message`: dotted name, type, owner, and name there.

    They come in wire order; empty arrays are left out.
    """
    for name, value in vars(message).items():
        if hasattr(value, "__msgtype__"):
            yield from numeric_fields(value, f"{prefix}{name}.")
        elif isinstance(value, np.ndarray | np.generic) and value.size:
            yield prefix + name, np.dtype((value.dtype, value.shape)), message, name


def _numpy_type(base: str) -> np.dtype[Any]:
    """Return the NumPy type of a base type of ROS 2, little endian."""
    return np.dtype({"bool": "uint8", "octet": "uint8"}.get(base, base)).newbyteorder("<")

"""What rosbags' type store knows of a message type, as a memory layout needs it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype

from bus_schema.messages.types import TYPESTORE

NUMPY_TYPES = {
    "bool": "u1", "octet": "u1", "uint8": "u1", "int8": "i1", "uint16": "<u2", "int16": "<i2",
    "uint32": "<u4", "int32": "<i4", "uint64": "<u8", "int64": "<i8",
    "float32": "<f4", "float64": "<f8",
}  # fmt: skip


def fields_of(type_name: str) -> Iterator[tuple[str, Nodetype, Any]]:
    """Name, kind and argument of each field of a type, as rosbags' type store has them."""
    for name, (kind, argument) in TYPESTORE.fielddefs[type_name][1]:
        yield name, kind, argument


def zero_message(
    type_name: str, lengths: Mapping[str, int], strings: Mapping[str, list[str]], prefix: str = ""
) -> Any:
    """A message of a type with arrays of these lengths, all zero, and these strings."""
    values: dict[str, Any] = {}
    for field, kind, argument in fields_of(type_name):
        path = prefix + field
        if kind == Nodetype.NAME:
            values[field] = zero_message(argument, lengths, strings, path + ".")
        elif kind == Nodetype.BASE:
            values[field] = {"string": "", "bool": False}.get(argument[0], 0)
        elif argument[0][1][0] == "string":
            values[field] = strings.get(path, [])
        else:
            base = NUMPY_TYPES[argument[0][1][0]]
            values[field] = np.zeros(
                lengths[path] if kind == Nodetype.SEQUENCE else argument[1], base
            )
    return TYPESTORE.types[type_name](**values)


def numeric_fields(message: Any, prefix: str = "") -> Iterator[tuple[str, np.dtype[Any], Any, str]]:
    """Each number and array of a message in wire order: dotted name, type, owner, and name there.

    Empty arrays are left out.
    """
    for field, kind, argument in fields_of(message.__msgtype__):
        value, path = getattr(message, field), prefix + field
        if kind == Nodetype.NAME:
            yield from numeric_fields(value, f"{path}.")
        elif isinstance(value, np.ndarray):
            if value.size:
                yield path, np.dtype((value.dtype, value.shape)), message, field
        elif not isinstance(value, str | list):
            yield path, np.dtype(NUMPY_TYPES[argument[0]]), message, field

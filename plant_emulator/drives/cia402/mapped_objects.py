"""Values of the objects that a PDO maps, packed and unpacked by a table made once per mapping.

What canopen's node does for an object at every access (find it, ask who serves it, find its type)
is done when the table is made. Objects that are no whole numbers of a C type go canopen's way.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import NamedTuple

from canopen.objectdictionary import ODVariable
from canopen.sdo.exceptions import SdoAbortedError

from plant_emulator.drives.cia402.abort import Abort
from plant_emulator.drives.cia402.node import DriveNode, Writer


class Entry(NamedTuple):
    """An object mapped into a PDO."""

    object_index: int
    subindex: int
    bits: int


class _Field(NamedTuple):
    """Where an entry's value goes."""

    object_index: int
    subindex: int
    lowest: float
    highest: float
    write: Writer | None
    part: slice


def packer(node: DriveNode, entries: Sequence[Entry]) -> Callable[[], bytes]:
    """A function that gives the present values."""
    readers = [node.reader(entry.object_index) for entry in entries]
    served = [(read, entry[1]) for read, entry in zip(readers, entries, strict=True) if read]
    layout = _layout(node, entries)
    if layout is None or len(served) < len(entries):
        return lambda: b"".join(node.get_data(index, sub) for index, sub, _ in entries)
    pack = layout.pack
    if len(served) == 1:  # a statusword alone, looked at after every frame
        read_alone, only = served[0]
        return lambda: pack(read_alone(only))
    return lambda: pack(*[read(subindex) for read, subindex in served])


def unpacker(node: DriveNode, entries: Sequence[Entry]) -> Callable[[bytes], None]:
    """A function that writes values of the right length.

    It raises `SdoAbortedError` if an object does not take its value; those before it were written.
    """
    fields, start = [], 0
    for entry in entries:
        end = start + entry.bits // 8
        variable = node.find(entry.object_index, entry.subindex)
        lowest = float("-inf") if variable.min is None else variable.min
        highest = float("inf") if variable.max is None else variable.max
        write = node.writer(entry.object_index)
        fields.append(_Field(*entry[:2], lowest, highest, write, slice(start, end)))
        start = end
    layout = _layout(node, entries)

    def unpack_each(data: bytes) -> None:
        for index, subindex, _, _, _, part in fields:
            node.set_data(index, subindex, data[part])

    if layout is None:
        return unpack_each
    unpack, store = layout.unpack, node.data_store

    def unpack_all(data: bytes) -> None:
        for field, value in zip(fields, unpack(data), strict=True):
            index, subindex, lowest, highest, write, part = field
            if not lowest <= value <= highest:
                raise SdoAbortedError(Abort.TOO_HIGH if value > highest else Abort.TOO_LOW)
            if write is not None:
                write(subindex, value)
            store.setdefault(index, {})[subindex] = data[part]

    return unpack_all


def _layout(node: DriveNode, entries: Sequence[Entry]) -> struct.Struct | None:
    """The values one after the other; None if one is of a type that C does not have."""
    codes = ""
    for index, subindex, _ in entries:
        single = ODVariable.STRUCT_TYPES.get(node.find(index, subindex).data_type or 0)
        if type(single) is not struct.Struct:
            return None
        codes += single.format.removeprefix("<")
    return struct.Struct(f"<{codes}")

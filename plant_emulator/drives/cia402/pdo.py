"""Process data objects with configurable mapping (CiA 301, 7.2.2 and 7.5.2.34 to 38).

Values are packed and unpacked by a table made once per mapping. What canopen's node does for an
object at every access (find it, ask who serves it, find its type) is done when the table is made.
All objects that our EDS declares mappable are whole numbers of a C type; it gives them no limits.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from functools import partial
from operator import call
from typing import NamedTuple

from canopen.objectdictionary import ODVariable
from canopen.sdo.exceptions import SdoAbortedError

from plant_emulator.drives.cia402.errors import check_identifier
from plant_emulator.drives.cia402.node import Abort, DriveNode

_RECEIVED, _SENT, _TO_MAPPING = 0x1400, 0x1800, 0x200
_NOT_VALID, _NO_REMOTE = 1 << 31, 1 << 30
_LAST_SYNCHRONOUS, _EVENT_DRIVEN = 240, (254, 255)
_MOST_BITS = 64
_MOST_ENTRIES = 8
_COB_ID, _TYPE, _INHIBIT, _EVENT = 1, 2, 3, 5
_MS, _INHIBIT_UNIT = 1_000_000, 100_000


class PdoEntry(NamedTuple):
    """An object mapped into a PDO."""

    object_index: int
    subindex: int
    bits: int


class Pdo:
    """One PDO: communication and mapping parameters, checked as they are written; its last data.

    Args:
        node: whose it is.
        number: counted from 0.
        is_received: an RPDO.

    Attributes:
        identifier: CAN identifier.
        is_valid: it exists.
        answers_remote: it may be asked for by a remote frame.
        period: number of SYNCs from one to the next; 0 for synchronous, but only if changed.
        is_synchronous: it goes with SYNC.
        inhibit_ns: shortest time between two.
        event_ns: time after which it is sent anyway, or awaited no longer; 0 for none.
        entries: what is mapped.
        length: bytes.
        pack: gives the mapped objects' values.
        unpack: writes the mapped objects; raises `SdoAbortedError` if one does not take its value,
            those before it were written.
        received_ns: when it came last, if it is awaited again.
        data: what was sent last, or has come and is in force from the next SYNC on.
        sent_ns: when it was sent.
        syncs: SYNCs since then.
    """

    pack: Callable[[], bytes]
    unpack: Callable[[bytes], None]

    def __init__(self, node: DriveNode, number: int, *, is_received: bool) -> None:
        self._node, self._is_received = node, is_received
        self._communication = (_RECEIVED if is_received else _SENT) + number
        self._mapping = self._communication + _TO_MAPPING
        node.writers[self._communication] = self._check_communication
        node.writers[self._mapping] = self._check_mapping
        self.rest()
        self._map([])
        self.note_set_up()

    def note_set_up(self) -> None:
        """Read the parameters again, which may have changed."""
        cob_id, self.period, inhibit, event = (
            self._parameter(each) for each in (_COB_ID, _TYPE, _INHIBIT, _EVENT)
        )
        self.identifier, self.is_valid = cob_id & 0x7FF, not cob_id & _NOT_VALID
        self.answers_remote = not self._is_received and not cob_id & _NO_REMOTE
        self.is_synchronous = self.period <= _LAST_SYNCHRONOUS
        self.inhibit_ns, self.event_ns = inhibit * _INHIBIT_UNIT, event * _MS
        entries = self._mapped(self._node.values[self._mapping << 8])
        if entries != self.entries:
            self._map(entries)

    def rest(self) -> None:
        """Reset all pending, awaited and sent data."""
        self.received_ns: int | None = None
        self.data: bytes | None = None
        self.sent_ns = self.syncs = 0

    def _parameter(self, subindex: int) -> int:
        return self._node.values[(self._communication << 8) + subindex]

    def _map(self, entries: list[PdoEntry]) -> None:
        self.entries, self.length = entries, sum(entry.bits for entry in entries) // 8
        self.data = None  # what there is has another mapping
        # Tables are made at the first use: only then is it certain who serves the objects.
        self.pack, self.unpack = self._first_pack, self._first_unpack

    def _first_pack(self) -> bytes:
        self.pack = packer(self._node, self.entries)
        return self.pack()

    def _first_unpack(self, data: bytes) -> None:
        self.unpack = unpacker(self._node, self.entries)
        self.unpack(data)

    def _check_communication(self, subindex: int, value: int) -> None:
        if subindex == _COB_ID:
            check_identifier(value & ~_NO_REMOTE, self._parameter(_COB_ID))
        is_no_type = value > _LAST_SYNCHRONOUS and value not in _EVENT_DRIVEN
        # An inhibit time may not be changed while the PDO exists.
        if (subindex == _TYPE and is_no_type) or (subindex == _INHIBIT and self.is_valid):
            raise SdoAbortedError(Abort.INVALID_VALUE)
        if subindex == _EVENT:
            self.received_ns = None  # watched from the next arrival on (CiA 301, 7.5.2.35)

    def _check_mapping(self, subindex: int, value: int) -> None:
        """Destroy the PDO, set the count to 0, map, set the count, create it: else no access."""
        if self.is_valid or (subindex and self.entries):
            raise SdoAbortedError(Abort.UNSUPPORTED_ACCESS)
        if subindex == 0:
            is_too_long = value > _MOST_ENTRIES
            if is_too_long or sum(entry.bits for entry in self._mapped(value)) > _MOST_BITS:
                raise SdoAbortedError(Abort.PDO_TOO_LONG)
        elif value:  # 0 empties the slot
            self._entry(value)

    def _mapped(self, count: int) -> list[PdoEntry]:
        return [self._entry(self._node.values[(self._mapping << 8) + i + 1]) for i in range(count)]

    def _entry(self, value: int) -> PdoEntry:
        """Return the mapping of a parameter, if it can be mapped here."""
        entry = PdoEntry(value >> 16, value >> 8 & 0xFF, value & 0xFF)
        try:
            variable = self._node.find(entry.object_index, entry.subindex)
        except SdoAbortedError:
            raise SdoAbortedError(Abort.NO_SUCH_OBJECT) from None
        is_open = variable.writable if self._is_received else variable.readable
        if not (variable.pdo_mappable and is_open and len(variable) == entry.bits):
            raise SdoAbortedError(Abort.NOT_MAPPABLE)
        return entry


def packer(node: DriveNode, entries: Sequence[PdoEntry]) -> Callable[[], bytes]:
    """Return a function that returns the present values."""
    pack = _layout(node, entries).pack
    stored = node.values.__getitem__
    reads: list[Callable[[], int]] = []
    for index, subindex, _ in entries:
        read = node.readers.get(index)
        place = index << 8 | subindex
        reads.append(partial(stored, place) if read is None else partial(read, subindex))
    return lambda: pack(*map(call, reads))


def unpacker(node: DriveNode, entries: Sequence[PdoEntry]) -> Callable[[bytes], None]:
    """Return a function that writes values of the right length.

    It raises `SdoAbortedError` if an object does not take its value; those before it were written.
    """
    layout, values = _layout(node, entries), node.values
    fields = [(node.writers.get(index), index << 8 | subindex) for index, subindex, _ in entries]

    def unpack(data: bytes) -> None:
        for (check, place), value in zip(fields, layout.unpack(data), strict=True):
            if check is not None:
                check(place & 0xFF, value)
            values[place] = value

    return unpack


def _layout(node: DriveNode, entries: Sequence[PdoEntry]) -> struct.Struct:
    """The values one after the other."""
    types = [node.find(index, subindex).data_type or 0 for index, subindex, _ in entries]
    codes = (ODVariable.STRUCT_TYPES[each].format.removeprefix("<") for each in types)
    return struct.Struct("<" + "".join(codes))

"""A CANopen node without threads: canopen's local node and SDO server, made passive and strict.

What canopen's server leaves open is closed here: transfers that were never begun, downloads of any
length, sub-indices that a variable or an array does not have, limits of values.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from enum import IntEnum
from typing import Any

import canopen
from canopen.objectdictionary import NUMBER_TYPES, ObjectDictionary, ODVariable
from canopen.sdo.exceptions import SdoAbortedError
from canopen.sdo.server import SdoServer

from bus_schema.can.cia402.canopen_adapter import CanopenNetwork, object_dictionary
from bus_schema.link.can_configuration import CIA402_EDS
from plant_emulator.drives.drive import Send

SDO_BYTES = 8
LAST_COMMUNICATION = 0x1FFF
_COMMAND_MASK, _ABORTED = 0xE0, 0x80
_DOWNLOAD_SEGMENT, _UPLOAD_SEGMENT = 0x00, 0x60
_EXPEDITED, _SIZED, _LAST_SEGMENT = 0x02, 0x01, 0x01
_LONGEST_DOWNLOAD = 64
_REQUEST = struct.Struct("<BHB")

Reader = Callable[[int], int]
"""Gives the value of a sub-index; raises `SdoAbortedError` to refuse."""

Writer = Callable[[int, int], None]
"""Takes a sub-index and the value written to it; raises `SdoAbortedError` to refuse."""


class Abort(IntEnum):
    """Reason why an SDO transfer was refused (abort codes of CiA 301, table 22 of 7.2.4.3.17)."""

    UNKNOWN_COMMAND = 0x0504_0001
    OUT_OF_MEMORY = 0x0504_0005
    UNSUPPORTED_ACCESS = 0x0601_0000
    READ_ONLY = 0x0601_0002
    NO_SUCH_OBJECT = 0x0602_0000
    NOT_MAPPABLE = 0x0604_0041
    PDO_TOO_LONG = 0x0604_0042
    INCOMPATIBLE = 0x0604_0043
    NO_SUCH_SUBINDEX = 0x0609_0011
    INVALID_VALUE = 0x0609_0030
    TOO_HIGH = 0x0609_0031
    TOO_LOW = 0x0609_0032
    MAXIMUM_BELOW_MINIMUM = 0x0609_0036
    NO_DATA = 0x0800_0024


class StrictSdoServer(SdoServer):
    """canopen's SDO server, made as strict as CiA 301 and robust against invalid requests."""

    def __init__(self, node: canopen.LocalNode, node_id: int) -> None:
        super().__init__(0x600 + node_id, 0x580 + node_id, node)
        self._index, self._subindex = 0, 0
        self._pending: int | None = None

    def on_request(self, can_id: int, data: bytes, timestamp: float) -> None:
        """Answer one request of eight bytes."""
        command = data[0] & _COMMAND_MASK
        if command in (_DOWNLOAD_SEGMENT, _UPLOAD_SEGMENT):
            if self._pending != command:
                self.abort(Abort.UNKNOWN_COMMAND)
                return
        else:
            self._pending = None
            if command != _ABORTED:
                _, self._index, self._subindex = _REQUEST.unpack_from(data)
        super().on_request(can_id, data, timestamp)

    def init_upload(self, request: bytes) -> None:
        """Begin an upload."""
        self._buffer = None
        super().init_upload(request)
        if self._buffer is not None:
            self._pending = _UPLOAD_SEGMENT

    def init_download(self, request: bytes) -> None:
        """Begin a download of an object that exists and is writable."""
        entry = self._node.find(self._index, self._subindex)
        if not entry.writable:
            raise SdoAbortedError(Abort.READ_ONLY)
        command = request[0]
        if command & _EXPEDITED and not command & _SIZED:
            # The client left the size to the dictionary: say it for canopen, which would take 4.
            unused = max(0, 4 - len(entry) // 8)
            request = bytes([command | _SIZED | unused << 2]) + bytes(request[1:])
        super().init_download(request)
        if not command & _EXPEDITED:
            self._pending = _DOWNLOAD_SEGMENT

    def segmented_upload(self, command: int) -> None:
        """Send one segment."""
        super().segmented_upload(command)
        if not self._buffer:
            self._pending = None

    def segmented_download(self, command: int, request: bytes) -> None:
        """Receive one segment."""
        if len(self._buffer or b"") > _LONGEST_DOWNLOAD:
            raise SdoAbortedError(Abort.OUT_OF_MEMORY)
        if command & _LAST_SEGMENT:
            self._pending = None
        super().segmented_download(command, request)

    def abort(self, abort_code: int = 0x0800_0000) -> None:
        """End the transfer with a reason."""
        self._pending = None
        super().abort(abort_code)


class DriveNode(canopen.LocalNode):
    """A node with the drive's dictionary, which holds the values of all its objects.

    Args:
        node_id: its address.
        send: takes the frames it sends.

    Attributes:
        node_id: its address.
        now_ns: the time of what is being done.
        targets: target torques and, in position mode, target positions taken so far.
        is_set_up_anew: an object of the communication profile was written.
        values: of the numeric objects that are stored, by index and sub-index, such as 0x1018_01.
        readers: where the values of objects come from that are not stored, by index.
        writers: what checks values that are written to objects, by index, before they are stored.
    """

    def __init__(self, node_id: int, send: Send) -> None:
        super().__init__(node_id, object_dictionary(CIA402_EDS, node_id))
        self.sdo = StrictSdoServer(self, node_id)
        self.network = CanopenNetwork(send)
        self.sdo.network = self.emcy.network = self.network
        self.node_id = node_id
        self.now_ns = self.targets = 0
        self.is_set_up_anew = False
        self.readers: dict[int, Reader] = {}
        self.writers: dict[int, Writer] = {}
        self._read_callbacks = [self._read_number]
        self._write_callbacks = [self._write_number]
        self._defaults = dict(_defaults(self.object_dictionary))
        self.values = self._defaults.copy()

    def fit(self, place: int, value: int) -> None:
        """Replace the EDS default of an object for this drive."""
        self._defaults[place] = self.values[place] = value

    def restore_defaults(self, first: int, last: int) -> None:
        """Discard the values written to the objects from `first` to `last`."""
        for index in [index for index in self.data_store if first <= index <= last]:
            del self.data_store[index]
        self.values.update(
            (place, value) for place, value in self._defaults.items() if first <= place >> 8 <= last
        )

    def find(self, index: int, subindex: int) -> ODVariable:
        """The description of an object.

        Raises:
            SdoAbortedError: there is none.
        """
        entry = self.object_dictionary.indices.get(index)
        if entry is None:
            raise SdoAbortedError(Abort.NO_SUCH_OBJECT)
        members = {0: entry} if isinstance(entry, ODVariable) else entry.subindices
        if subindex not in members:
            raise SdoAbortedError(Abort.NO_SUCH_SUBINDEX)
        return members[subindex]

    _find_object = find  # what canopen's own methods call

    def _read_number(self, index: int, subindex: int, **_: Any) -> int | None:
        read = self.readers.get(index)
        return self.values.get(index << 8 | subindex) if read is None else read(subindex)

    def _write_number(self, index: int, subindex: int, od: ODVariable, data: bytes) -> None:
        if od.data_type not in NUMBER_TYPES:
            return
        value = int(od.decode_raw(data))
        if od.max is not None and value > od.max:
            raise SdoAbortedError(Abort.TOO_HIGH)
        if od.min is not None and value < od.min:
            raise SdoAbortedError(Abort.TOO_LOW)
        write = self.writers.get(index)
        if write is not None:
            write(subindex, value)
        self.values[index << 8 | subindex] = value
        self.is_set_up_anew |= index <= LAST_COMMUNICATION


def _defaults(dictionary: ObjectDictionary) -> Iterator[tuple[int, int]]:
    """Place and default of all numbers that have one."""
    for entry in dictionary.values():
        for each in (entry,) if isinstance(entry, ODVariable) else entry.values():
            default = each.default if each.value is None else each.value
            if each.data_type in NUMBER_TYPES and default is not None:
                yield each.index << 8 | each.subindex, int(default)

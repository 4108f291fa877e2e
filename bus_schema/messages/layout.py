"""Fixed memory layouts of CDR messages.

Once the strings and the array lengths of a message are known (the joints of a robot do not change
during a run), the CDR encoding of its type is a constant byte layout. A `MessageLayout` is that
layout as a NumPy structured type of the *whole payload*: writing a field writes the wire bytes, so
encoding is a memory copy and decoding a copy and a comparison. rosbags remains the reference: the
template and the places of all fields come from it, and payloads of another layout (a foreign
sender) are parsed by it.
"""

from __future__ import annotations

import ctypes
import re
import struct
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype

from bus_schema.errors import InvalidMessageError
from bus_schema.messages.record import DIGITS, KnownRows, Record
from bus_schema.messages.types import NANOSEC, NANOSECONDS, TYPESTORE

MAX_PAYLOAD_BYTES = 64 * 1024
"""Limit far above all our messages; larger payloads are refused before they are parsed."""

MOST_ROWS = 1000
"""Of one message, if it may have several."""

_ACTS_AFTER = "acts_after_ns="
"""A command's frame_id, if it says when it acts: this and `DIGITS` digits."""
_ROW_TICKS = " row_ticks="
"""What follows if it has rows that lie several ticks apart: this and their number."""
_MOST_KEPT = 4
"""Layouts with rows that a layout keeps; a sender uses one."""
_TIMES = re.compile(f"{_ACTS_AFTER}([0-9]{{1,{DIGITS}}})(?:{_ROW_TICKS}([1-9][0-9]{{0,3}}))?")


class MessageLayout:
    """Wire layout of one message type with fixed strings and array lengths.

    Args:
        type_name: ROS 2 interface name, e.g. ``sensor_msgs/msg/JointState``.
        length: length of every numeric array that `lengths` does not name.
        lengths: lengths of single arrays, by dotted field name; arrays of length 0 are no fields;
            their content from a foreign sender is ignored.
        strings: value of every string sequence, by dotted field name; plain strings are empty.
        may_have_rows: arrays of a foreign sender may hold several rows, one after the other.
        has_acting_time: the header's frame_id says when a command acts, see `Record.acts_after_ns`.
        row_ticks: ticks from one row of a command that says when it acts to the next.

    Attributes:
        acts_after_at: place of the digits of that time; None without them.
        length, row_ticks: as given.
    """

    def __init__(
        self,
        type_name: str,
        length: int,
        *,
        lengths: Mapping[str, int] | None = None,
        strings: Mapping[str, Sequence[str]] | None = None,
        may_have_rows: bool = False,
        has_acting_time: bool = False,
        row_ticks: int = 1,
    ) -> None:
        self.type_name, self._may_have_rows = type_name, may_have_rows
        self.length, self._given, self.row_ticks = length, dict(lengths or {}), row_ticks
        self._of_rows: dict[int, KnownRows] = {}
        self._lengths = defaultdict(lambda: length, lengths or {})
        self._strings = {name: list(values) for name, values in (strings or {}).items()}
        message = _zero_message(type_name, self._lengths, self._strings)
        if has_acting_time:
            apart = f"{_ROW_TICKS}{row_ticks}" if row_ticks > 1 else ""
            message.header.frame_id = f"{_ACTS_AFTER}{0:0{DIGITS}}{apart}"
        self.template = bytes(TYPESTORE.serialize_cdr(message, type_name))
        place = self.template.find(_ACTS_AFTER.encode()) + len(_ACTS_AFTER)
        self.acts_after_at = place if has_acting_time else None
        self.size = len(self.template)
        self.dtype = self._numpy_type(message)
        self.scalars = self._scalar_type()
        self._is_fixed = self._fixed_bytes()
        self._fixed_parts = _parts(self._is_fixed)
        self._expected_parts = self._fixed_parts.unpack(self.template)

    def decode(self, payload: bytes, into: Record) -> int:
        """Load `payload`, from any sender, into `into`; return its stamp in ns.

        Raises:
            InvalidMessageError: the payload is no message of this type with these names and
                lengths.
        """
        if self._is_ours(payload):
            into.memory[:], into.later = payload, None
        elif (of_rows := self._of_rows.get(len(payload))) and of_rows.layout._is_ours(payload):
            if not of_rows.take(payload, into):
                raise InvalidMessageError("malformed", "its acting time is not a number")
        else:
            self._decode_foreign(payload, into)
            self._remember_rows(payload, into)
        nanosec = into.nanosec[0]
        if nanosec >= NANOSECONDS:
            raise InvalidMessageError("malformed", "its stamp is not a valid time")
        return into.sec[0] * NANOSECONDS + nanosec

    def _is_ours(self, payload: bytes) -> bool:
        """Whether a payload differs from the template in fields alone."""
        return (
            len(payload) == self.size and self._fixed_parts.unpack(payload) == self._expected_parts
        )

    def _remember_rows(self, payload: bytes, into: Record) -> None:
        """Keep the layout of a message with rows: the next one need not be parsed by rosbags."""
        if into.later is None or self.acts_after_at is None or len(self._of_rows) == _MOST_KEPT:
            return
        of_rows = MessageLayout(
            self.type_name, self.length * (1 + len(into.later)),
            lengths=self._given, strings=self._strings,
            has_acting_time=True, row_ticks=into.row_ticks,
        )  # fmt: skip
        if of_rows._is_ours(payload):
            self._of_rows[of_rows.size] = KnownRows(of_rows, self)

    def tabulate(self, payloads: Sequence[bytes]) -> NDArray[np.void]:
        """Return messages as rows of a table, shape (messages,); skip what `decode` rejects.

        Of a message with several rows, the first is in the table.
        """
        if set(map(len, payloads)) <= {self.size}:
            joined = b"".join(payloads)
            block = np.frombuffer(joined, np.uint8).reshape(-1, self.size)
            table = np.frombuffer(joined, self.dtype)
            fixed = np.flatnonzero(self._is_fixed)
            template = np.frombuffer(self.template, np.uint8)
            is_ours = (block[:, fixed] == template[fixed]).all()
            if is_ours and (table[NANOSEC] < NANOSECONDS).all():
                return table
        return np.frombuffer(b"".join(self._decodable(payloads)), self.dtype)

    def _decodable(self, payloads: Iterable[bytes]) -> Iterator[bytes]:
        """Yield the payloads that can be decoded, each in this layout."""
        record = Record(self)
        for payload in payloads:
            try:
                self.decode(payload, record)
            except InvalidMessageError:
                continue
            yield record.payload()

    def _decode_foreign(self, payload: bytes, into: Record) -> None:
        message = parse(payload, self.type_name)
        order = None
        for name, expected in self._strings.items():
            order = _permutation(_attribute(message, name), expected, name)
        values = {name: np.asarray(_attribute(message, name)) for name in into.fields}
        rows = self._count_rows(values)
        table = np.frombuffer(bytearray(self.template * rows), self.dtype)
        for name, value in values.items():
            if value.ndim == 0:
                table[name] = value
            elif value.size == 0:
                table[name] = np.nan  # a JointState may leave out what its sender does not know
            else:
                by_row = value.reshape(rows, -1)
                table[name] = by_row if order is None else by_row[:, order]
        into.memory[:] = table[:1].tobytes()
        into.later = table[1:] if rows > 1 else None
        if self.acts_after_at is not None:
            into.acts_after_ns, into.row_ticks = _times(message.header.frame_id)

    def _count_rows(self, values: Mapping[str, NDArray[Any]]) -> int:
        """Return how many rows the arrays of a foreign message hold; all hold as many, or none.

        Raises:
            InvalidMessageError: an array has another size.
        """
        lengths = {name: self.dtype[name].shape[0] for name, value in values.items() if value.ndim}
        rows = 1
        if self._may_have_rows:
            rows = max(1, *(values[name].size // length for name, length in lengths.items()))
        for name, length in lengths.items():
            size = values[name].size
            if size not in (0, rows * length):
                raise InvalidMessageError(
                    "wrong_size", f"{name} has {size} entries where {rows * length} are expected"
                )
        if rows > MOST_ROWS:
            raise InvalidMessageError("wrong_size", f"{rows} rows, at most {MOST_ROWS} are read")
        return rows

    def _numpy_type(self, message: Any) -> np.dtype[np.void]:
        """Return all numeric fields as a NumPy type, at the offsets where rosbags writes them."""
        template = np.frombuffer(self.template, np.uint8)
        fields: dict[str, tuple[np.dtype[Any], int]] = {}
        for path, kind, owner, name in _numeric_fields(message):
            zero, ones = getattr(owner, name), np.frombuffer(b"\1" * kind.itemsize, kind.base)
            setattr(owner, name, ones if kind.shape else ones[0].item())
            encoded = TYPESTORE.serialize_cdr(message, self.type_name)
            setattr(owner, name, zero)
            offset = np.flatnonzero(np.frombuffer(encoded, np.uint8) != template)[0]
            fields[path] = kind, int(offset)
        kinds, offsets = zip(*fields.values(), strict=True)
        return np.dtype(
            {"names": list(fields), "formats": kinds, "offsets": offsets, "itemsize": self.size}
        )

    def _scalar_type(self) -> type[ctypes.LittleEndianStructure]:
        """Return the single values of a payload as a C structure, other bytes as padding."""
        members: list[tuple[str, Any]] = []
        end = 0
        fields: Mapping[str, Any] = self.dtype.fields or {}
        for name, (kind, offset, *_) in fields.items():
            if not kind.shape:
                members.append((f"_{offset}", ctypes.c_char * (offset - end)))
                members.append((name.replace(".", "_"), np.ctypeslib.as_ctypes_type(kind)))
                end = offset + kind.itemsize
        body = {"__slots__": (), "_pack_": 1, "_fields_": members}
        return type("Scalars", (ctypes.LittleEndianStructure,), body)

    def _fixed_bytes(self) -> NDArray[np.bool_]:
        """Mark the bytes that belong to no field, shape (size,)."""
        is_fixed = np.ones(self.size, dtype=np.bool_)
        fields: Mapping[str, Any] = self.dtype.fields or {}
        for kind, offset, *_ in fields.values():
            is_fixed[offset : offset + kind.itemsize] = False
        if self.acts_after_at is not None:
            is_fixed[self.acts_after_at : self.acts_after_at + DIGITS] = False
        return is_fixed


def parse(payload: bytes, type_name: str) -> Any:
    """Parse a payload with rosbags.

    Raises:
        InvalidMessageError: the payload is too large or not a message of that type.
    """
    if len(payload) > MAX_PAYLOAD_BYTES:
        raise InvalidMessageError(
            "oversized", f"{len(payload)} bytes, at most {MAX_PAYLOAD_BYTES} are accepted"
        )
    try:
        return TYPESTORE.deserialize_cdr(payload, type_name)
    except Exception as error:  # rosbags raises many kinds of errors on garbage
        raise InvalidMessageError("malformed", f"not a {type_name}: {error}") from error


def _parts(is_wanted: NDArray[np.bool_]) -> struct.Struct:
    """Return a function that extracts the wanted runs of bytes from a payload of this size."""
    runs = [(wanted, len(list(run))) for wanted, run in groupby(is_wanted.tolist())]
    return struct.Struct("".join(f"{size}{'s' if wanted else 'x'}" for wanted, size in runs))


def _times(frame_id: str) -> tuple[int, int]:
    """Return when a command acts by its frame_id, ns after its stamp, and the ticks of a row.

    A command that does not say so acts on arrival (0), and has a row for each tick (1).

    Raises:
        InvalidMessageError: it says so in another form.
    """
    found = _TIMES.fullmatch(frame_id)
    if found is None and frame_id.startswith(_ACTS_AFTER):
        allowed = f"{_ACTS_AFTER}, 1 to {DIGITS} digits, and perhaps{_ROW_TICKS}1 to 9999"
        raise InvalidMessageError("malformed", f"frame_id is {frame_id[:80]!r}, expected {allowed}")
    return (int(found[1]), int(found[2] or 1)) if found else (0, 1)


def _attribute(message: Any, dotted: str) -> Any:
    for part in dotted.split("."):
        message = getattr(message, part)
    return message


def _permutation(received: list[str], expected: list[str], name: str) -> list[int]:
    if sorted(received) != sorted(expected):
        raise InvalidMessageError("wrong_names", f"{name} is {received!r}, expected {expected!r}")
    return [received.index(value) for value in expected]


def _zero_message(
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
            values[field] = _zero_message(argument, lengths, strings, path + ".")
        elif kind == Nodetype.BASE:
            values[field] = "" if argument[0] == "string" else _numpy_type(argument[0]).type(0)
        elif argument[0][1][0] == "string":
            values[field] = strings.get(path, [])
        else:
            length = lengths[path] if kind == Nodetype.SEQUENCE else argument[1]
            values[field] = np.zeros(length, _numpy_type(argument[0][1][0]))
    return TYPESTORE.types[type_name](**values)


def _numeric_fields(
    message: Any, prefix: str = ""
) -> Iterator[tuple[str, np.dtype[Any], Any, str]]:
    """Yield each number and array of a `_zero_message`: dotted name, type, owner, and name there.

    They come in wire order; empty arrays are left out.
    """
    for name, value in vars(message).items():
        if hasattr(value, "__msgtype__"):
            yield from _numeric_fields(value, f"{prefix}{name}.")
        elif isinstance(value, np.ndarray | np.generic) and value.size:
            yield prefix + name, np.dtype((value.dtype, value.shape)), message, name


def _numpy_type(base: str) -> np.dtype[Any]:
    """Return the NumPy type of a base type of ROS 2, little endian."""
    return np.dtype({"bool": "uint8", "octet": "uint8"}.get(base, base)).newbyteorder("<")

"""One message in memory: its fields by name, over the bytes of the wire."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bus_schema.messages.types import ENCAPSULATION_BYTES, NANOSECONDS

if TYPE_CHECKING:
    from bus_schema.messages.layout import MessageLayout

DIGITS = 10
"""Of the time after which a command acts."""


class Record:
    """One message with fields by name; its memory is the wire format.

    Attributes:
        scalars: all single values, as attributes named as in the ``.msg`` file, with ``_`` for the
            dots of nested types: ``record.scalars.timing_cycle = 3``. An unknown name raises; a
                number out of range wraps around.
        fields: one writable view per numeric field, by dotted name; single values as shape (1,).
        memory: the message's bytes, writable.
        stamp: bytes of the header's stamp; copying them costs half as much as writing `stamp_ns`.
        sec: first part of the stamp, shape (1,), writable; nanosec: the other part.
        payload: returns the message as wire bytes.
        later: of a message with several rows, those after the first, as a table with the columns of
            `MessageLayout.dtype`; None for one row.
        row_ticks: ticks from one of these rows to the next.
    """

    def __init__(self, layout: MessageLayout) -> None:
        # The payload starts 4 bytes off an 8-byte boundary, so that the doubles behind the
        # 4-byte encapsulation header are aligned in memory.
        storage = np.zeros(ENCAPSULATION_BYTES + layout.size, dtype=np.uint8)
        self.memory = storage.data[ENCAPSULATION_BYTES:]
        self.memory[:] = layout.template
        payload: NDArray[np.void] = np.ndarray(
            (1,), layout.dtype, storage.data, ENCAPSULATION_BYTES
        )
        self.fields: dict[str, NDArray[Any]] = {
            name: payload[name][0] if payload[name].ndim == 2 else payload[name]
            for name in layout.dtype.names or ()
        }
        self.scalars: Any = layout.scalars.from_buffer(self.memory)
        self.payload = self.memory.tobytes  # no method around it: saves five frames a tick
        self.stamp = self.memory[ENCAPSULATION_BYTES : ENCAPSULATION_BYTES + 8]
        # Used in each tick: these views take a third of the time of the above.
        self.sec, self.nanosec = self.stamp[:4].cast("i"), self.stamp[4:].cast("I")
        self.later: NDArray[np.void] | None = None
        self.row_ticks = 1
        begin = layout.acts_after_at
        self._digits = None if begin is None else self.memory[begin : begin + DIGITS]

    @property
    def acts_after_ns(self) -> int:
        """Time from the stamp until a command acts; 0 for on arrival."""
        digits = b"" if self._digits is None else self._digits.tobytes()
        return int(digits) if digits.isdigit() else 0

    @acts_after_ns.setter
    def acts_after_ns(self, acts_after_ns: int) -> None:
        assert self._digits is not None  # of a command that says when it acts
        self._digits[:] = b"%0*d" % (DIGITS, acts_after_ns)

    def take_acting_time(self, other: Record) -> bool:
        """Copy the time after which another command acts; return whether it is a number."""
        assert self._digits is not None
        assert other._digits is not None
        self._digits[:] = other._digits
        return other._digits.tobytes().isdigit()

    @property
    def stamp_ns(self) -> int:
        """Stamp of the header, which every message begins with."""
        return self.sec[0] * NANOSECONDS + self.nanosec[0]

    @stamp_ns.setter
    def stamp_ns(self, stamp_ns: int) -> None:
        self.sec[0], self.nanosec[0] = divmod(stamp_ns, NANOSECONDS)

    def rows(self, *names: str) -> NDArray[np.float64]:
        """Return consecutive arrays as the rows of one writable view, shape (arrays, length).

        Raises:
            ValueError: the arrays differ in length or are not adjacent in this order.
        """
        all_names = list(self.fields)
        first = all_names.index(names[0])
        if tuple(all_names[first : first + len(names)]) != names:
            raise ValueError(f"{', '.join(names)} do not follow one another in the message")
        views = [self.fields[name] for name in names]
        strides = set(np.diff([view.ctypes.data for view in views]).tolist())
        kinds = {(view.dtype, view.shape) for view in views}
        if len(strides) != 1 or len(kinds) != 1 or views[0].dtype != np.float64:
            raise ValueError(f"{', '.join(names)} are not arrays of doubles of one length")
        return np.lib.stride_tricks.as_strided(
            views[0], (len(views), views[0].size), (strides.pop(), views[0].itemsize)
        )


class KnownRows:
    """Messages with several rows, of one layout: the next one is copied instead of parsed.

    Args:
        layout: that of the message.
        of_one_row: that of each row; what `take` loads has it.
    """

    def __init__(self, layout: MessageLayout, of_one_row: MessageLayout) -> None:
        self.layout = layout
        self._message = Record(layout)
        rows = layout.length // of_one_row.length
        storage = bytearray(of_one_row.template * rows)
        table = np.frombuffer(storage, of_one_row.dtype)
        self._first, self._later = memoryview(storage)[: of_one_row.size], table[1:]
        self._copies = [
            (table[name], value.reshape(rows, -1) if table[name].ndim > 1 else value)
            for name, value in self._message.fields.items()
        ]

    def take(self, payload: bytes, into: Record) -> bool:
        """Load a message into a record, until the next one; False if its acting time is none."""
        message = self._message
        message.memory[:] = payload
        for rows, values in self._copies:
            rows[...] = values
        into.memory[:], into.later = self._first, self._later
        into.row_ticks = self.layout.row_ticks
        return into.take_acting_time(message)

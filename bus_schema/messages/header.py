"""The stamp in the header of every message: seconds and nanoseconds, or one number.

On the wire (CDR, little endian) it follows the encapsulation directly in every type.
"""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

NANOSECONDS = 1_000_000_000
SEC, NANOSEC = "header.stamp.sec", "header.stamp.nanosec"
"""Names of both parts in a message's layout."""
ENCAPSULATION_BYTES = 4
_STAMP = struct.Struct("<iI")
_END = ENCAPSULATION_BYTES + _STAMP.size


def split_stamp(stamp_ns: int) -> tuple[int, int]:
    """Split a stamp in ns into seconds and nanoseconds."""
    return divmod(stamp_ns, NANOSECONDS)


def join_stamp(sec: int, nanosec: int) -> int:
    """Return a stamp in ns from both parts."""
    return sec * NANOSECONDS + nanosec


def stamp_of(payload: bytes) -> int | None:
    """Return the stamp of an encoded message, ns; None if it is missing or negative."""
    if len(payload) < _END:
        return None
    stamp_ns = join_stamp(*_STAMP.unpack_from(payload, ENCAPSULATION_BYTES))
    return stamp_ns if stamp_ns >= 0 else None


def with_stamp(payload: bytes, stamp_ns: int) -> bytes:
    """Return an encoded message with another stamp."""
    return payload[:ENCAPSULATION_BYTES] + _STAMP.pack(*split_stamp(stamp_ns)) + payload[_END:]


def stamps_ns(table: NDArray[np.void]) -> NDArray[np.int64]:
    """Return the stamps of a table of messages (`MessageLayout.tabulate`), shape (messages,)."""
    stamps: NDArray[np.int64] = table[SEC].astype(np.int64) * NANOSECONDS + table[NANOSEC]
    return stamps

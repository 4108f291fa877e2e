"""The stamp in the header that all our messages begin with: seconds and nanoseconds, or one number.

On the wire (CDR, little endian) it stands right behind the encapsulation, whatever the type.
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
    """Seconds and nanoseconds."""
    return divmod(stamp_ns, NANOSECONDS)


def join_stamp(sec: int, nanosec: int) -> int:
    """A stamp in ns from both parts."""
    return sec * NANOSECONDS + nanosec


def stamp_of(payload: bytes) -> int | None:
    """Stamp of an encoded message, ns; None where the bytes hold none, or one before the start."""
    if len(payload) < _END:
        return None
    stamp_ns = join_stamp(*_STAMP.unpack_from(payload, ENCAPSULATION_BYTES))
    return stamp_ns if stamp_ns >= 0 else None


def with_stamp(payload: bytes, stamp_ns: int) -> bytes:
    """An encoded message with another stamp."""
    return payload[:ENCAPSULATION_BYTES] + _STAMP.pack(*split_stamp(stamp_ns)) + payload[_END:]


def stamps_ns(table: NDArray[np.void]) -> NDArray[np.int64]:
    """Stamps of a table of messages (`MessageLayout.tabulate`), shape (messages,)."""
    stamps: NDArray[np.int64] = table[SEC].astype(np.int64) * NANOSECONDS + table[NANOSEC]
    return stamps

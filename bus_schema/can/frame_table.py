"""CAN frames as rows of a table, for compiled code to go through many at a time."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bus_schema.can.frame import CanFrame

FrameTable = NDArray[np.void]
"""One row for each frame, shape (frames,); its fields are those of `CanFrame`, and `data_bytes`."""

_MOST_BYTES = 64
_ROW = struct.Struct(f"<iB????3x{_MOST_BYTES}s")
_FIELDS: list[Any] = [
    ("identifier", "<i4"), ("data_bytes", "u1"),
    ("is_extended", "?"), ("is_remote", "?"), ("is_error", "?"), ("is_fd", "?"), ("_", "u1", 3),
    ("data", "u1", _MOST_BYTES),
]  # fmt: skip
_TYPE = np.dtype(_FIELDS)
_LARGEST_IDENTIFIER = 0x1FFF_FFFF


def frame_table(frames: Sequence[CanFrame]) -> FrameTable:
    """The frames as a table.

    What no controller could send, some interfaces carry all the same: bits and bytes beyond the
    formats are left out.
    """
    rows = [
        _ROW.pack(
            identifier & _LARGEST_IDENTIFIER, min(len(data), _MOST_BYTES),
            is_extended, is_remote, is_error, is_fd, data,
        )
        for identifier, data, is_extended, is_remote, is_error, is_fd in frames
    ]  # fmt: skip
    return np.frombuffer(b"".join(rows), _TYPE).copy()

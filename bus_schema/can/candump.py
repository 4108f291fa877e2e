"""Logs of CAN frames in the format of ``candump -L``, which every CAN tool reads."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bus_schema.can.frame import CanFrame
from bus_schema.can.frame_table import FrameTable, frame_table
from bus_schema.runtime.compiled import compiled

_ERROR_FLAG = 0x2000_0000
_DIGITS = np.frombuffer(b"0123456789ABCDEF", np.uint8)
_MOST_BYTES_A_LINE = 200
"""Beside the channel: time, identifier, and two for each byte of data."""


def candump_lines(times_ns: NDArray[np.int64], channel: str, table: FrameTable) -> bytes:
    """Frames as ``candump -L`` writes them: ``(seconds.microseconds) channel identifier#data``.

    Args:
        times_ns: when each was on the bus, shape (frames,).
        channel: name of the bus.
        table: the frames.
    """
    name = np.frombuffer(f") {channel} ".encode(), np.uint8)
    text = np.empty(table.size * (_MOST_BYTES_A_LINE + name.size), dtype=np.uint8)
    return text[: _write_lines(text, times_ns // 1000, name, table)].tobytes()


class CandumpLog:
    """A file of frames.

    Args:
        path: the file; overwritten.
        channel: name of the bus.
    """

    def __init__(self, path: Path, channel: str) -> None:
        self._file = path.open("wb")
        self._channel = channel
        # Compiled now: in the midst of a run that takes longer than a busy machine's time-outs.
        candump_lines(np.zeros(1, dtype=np.int64), channel, frame_table([CanFrame(0)]))

    def write(self, times_ns: NDArray[np.int64], table: FrameTable) -> None:
        """Append frames, see `candump_lines`."""
        self._file.write(candump_lines(times_ns, self._channel, table))

    def close(self) -> None:
        """Finish the file."""
        self._file.close()


@compiled
def _write_lines(
    text: NDArray[np.uint8], times_us: NDArray[np.int64], name: NDArray[np.uint8], table: FrameTable
) -> int:
    """Write a line for each frame; where the last one ends."""
    end = 0
    for row in range(table.size):
        frame = table[row]
        end = _write(text, end, ord("("))
        end = _write_number(text, end, times_us[row] // 1_000_000, 10, 1)
        end = _write(text, end, ord("."))
        end = _write_number(text, end, times_us[row] % 1_000_000, 10, 6)
        for letter in name:
            end = _write(text, end, letter)
        is_error = frame["is_error"]
        identifier = int(frame["identifier"]) | (_ERROR_FLAG if is_error else 0)
        is_long = frame["is_extended"] or is_error
        end = _write_number(text, end, identifier, 16, 8 if is_long else 3)
        end = _write(text, end, ord("#"))
        if frame["is_fd"]:
            end = _write(text, end, ord("#"))
            end = _write(text, end, ord("1"))  # the bit rate was switched
        if frame["is_remote"]:
            end = _write(text, end, ord("R"))
        else:
            for index in range(frame["data_bytes"]):
                end = _write_number(text, end, int(frame["data"][index]), 16, 2)
        end = _write(text, end, ord("\n"))
    return end


@compiled
def _write_number(text: NDArray[np.uint8], start: int, value: int, base: int, digits: int) -> int:
    """Write a number with at least so many digits; where it ends."""
    while base**digits <= value:
        digits += 1
    for place in range(digits):
        text[start + digits - 1 - place] = _DIGITS[value % base]
        value //= base
    return start + digits


@compiled
def _write(text: NDArray[np.uint8], end: int, letter: int) -> int:
    text[end] = letter
    return end + 1

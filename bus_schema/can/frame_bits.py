"""Bits of CAN frames, many frames at a time: how many each occupies, and which one wins the bus.

The frame formats are those of ISO 11898-1, stuff bits counted. What a frame occupies reaches from
its start-of-frame bit to the end of the interframe space (three bits), so that frames sent back to
back add up. Bytes beyond the format are not counted.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus_schema.can.frame_table import FrameTable
from bus_schema.runtime.compiled import compiled

CRC15_BITS = 15
CLASSICAL_TAIL_BITS = 13
"""CRC delimiter, ACK slot and delimiter, end of frame (7), interframe space (3)."""

FD_TAIL_BITS = 12
CRC17_FIELD_BITS = 4 + 17 + 6 + 1
"""Stuff count and CRC; a fixed stuff bit before them and after every fourth; the delimiter."""

CRC21_FIELD_BITS = 4 + 21 + 7 + 1
LARGEST_CRC17_BYTES = 16

_CRC15, _CRC15_MASK = 0x4599, 0x7FFF
_STUFFED_RUN = 5
_LONGEST_CLASSICAL_BYTES, _LONGEST_FD_BYTES = 8, 64
_FD_LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)
_MOST_BITS = 1 + 11 + 2 + 18 + 1 + 3 + 5 + 8 * _LONGEST_FD_BYTES


class FrameBits(NamedTuple):
    """What frames are on the wire; all of shape (frames,).

    Attributes:
        nominal: bits at the nominal rate.
        fast: bits at the data rate, of FD frames.
        arbitration: who has the least of those that wait at the same time wins the bus. It is the
            arbitration field filled up to the extended format's length with what a standard frame
            has there, dominant bits: it wins over an extended one with the same base identifier.
    """

    nominal: NDArray[np.int64]
    fast: NDArray[np.int64]
    arbitration: NDArray[np.int64]


def count_bits(table: FrameTable) -> FrameBits:
    """Bits of each frame, including the stuff bits that its content makes necessary."""
    counted = FrameBits(*np.empty((3, table.size), dtype=np.int64))
    _count(table, *counted)
    return counted


@compiled
def _count(
    table: FrameTable,
    nominal: NDArray[np.int64],
    fast: NDArray[np.int64],
    arbitration: NDArray[np.int64],
) -> None:
    """Count the bits of each frame of a table, see `FrameBits`."""
    bits = np.empty(_MOST_BITS, dtype=np.uint8)
    for row in range(table.size):
        frame = table[row]
        data, length = frame["data"], int(frame["data_bytes"])
        is_extended, is_fd = frame["is_extended"], frame["is_fd"]
        remote_bit = 1 if frame["is_remote"] and not is_fd else 0
        key = _arbitration(int(frame["identifier"]), is_extended, remote_bit)
        head_bits = 33 if is_extended else 13
        _put(bits, 0, key >> (33 - head_bits), head_bits)
        if is_fd:
            nominal[row], fast[row] = _fd_bits(bits, head_bits, is_extended, data, length)
        else:
            length = 0 if remote_bit else min(length, _LONGEST_CLASSICAL_BYTES)
            nominal[row], fast[row] = _classical_bits(bits, head_bits, data, length), 0
        arbitration[row] = key


@compiled
def _arbitration(identifier: int, is_extended: bool, remote_bit: int) -> int:
    """Start of frame to the remote bit of an extended frame, or of one as long as that."""
    if is_extended:
        base, rest = identifier >> 18 & 0x7FF, identifier & 0x3FFFF
        return (base << 2 | 0b11) << 19 | rest << 1 | remote_bit
    return ((identifier & 0x7FF) << 1 | remote_bit) << 20


@compiled
def _classical_bits(
    bits: NDArray[np.uint8], head_bits: int, data: NDArray[np.uint8], length: int
) -> int:
    """Bits of a frame whose first `head_bits` are there."""
    # IDE and r0, or r1 and r0 of an extended frame, and the DLC
    count = _put(bits, head_bits, length, 6)
    for index in range(length):
        count = _put(bits, count, int(data[index]), 8)
    count = _put(bits, count, _crc15(bits, count), CRC15_BITS)
    return count + _stuff_bits(bits, count, count)[0] + CLASSICAL_TAIL_BITS


@compiled
def _crc15(bits: NDArray[np.uint8], count: int) -> int:
    crc = 0
    for index in range(count):
        flips = bits[index] != crc >> (CRC15_BITS - 1)
        crc = crc << 1 & _CRC15_MASK
        if flips:
            crc ^= _CRC15
    return crc


@compiled
def _fd_bits(
    bits: NDArray[np.uint8], head_bits: int, is_extended: bool, data: NDArray[np.uint8], length: int
) -> tuple[int, int]:
    """As `_classical_bits`: at the nominal rate, and at the data rate."""
    dlc = 0
    while _FD_LENGTHS[dlc] < length:
        dlc += 1
    # IDE, of a standard frame; FDF, res, BRS: the last bit of the arbitration phase
    slow = _put(bits, head_bits, 0b101, 3 if is_extended else 4)
    count = _put(bits, slow, dlc, 5)  # ESI and DLC
    for index in range(_FD_LENGTHS[dlc]):
        count = _put(bits, count, int(data[index]), 8)
    # No stuff bit comes after the last bit: the CRC field begins with a fixed one.
    early, late = _stuff_bits(bits, count - 1, slow)
    crc_field = CRC17_FIELD_BITS if _FD_LENGTHS[dlc] <= LARGEST_CRC17_BYTES else CRC21_FIELD_BITS
    return slow + early + FD_TAIL_BITS, count - slow + late + crc_field


@compiled
def _put(bits: NDArray[np.uint8], start: int, value: int, width: int) -> int:
    """Write a value's bits, most significant first; where the next ones go."""
    for place in range(width):
        bits[start + place] = value >> (width - 1 - place) & 1
    return start + width


@compiled
def _stuff_bits(bits: NDArray[np.uint8], count: int, boundary: int) -> tuple[int, int]:
    """Stuff bits that a sequence makes necessary, before and after a boundary."""
    early, late, run, last = 0, 0, 0, 2
    for index in range(count):
        bit = int(bits[index])
        run = run + 1 if bit == last else 1
        last = bit
        if run == _STUFFED_RUN:
            run, last = 1, 1 - bit
            if index < boundary:
                early += 1
            else:
                late += 1
    return early, late

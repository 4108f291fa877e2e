"""Durations of CAN frames, and a check that those of a control cycle fit into its period.

Frames are rows of a table, for compiled code. The frame formats are those of ISO 11898-1, stuff
bits counted. What a frame occupies reaches from its start-of-frame bit to the end of the interframe
space (three bits), so that frames sent back to back add up. Bytes beyond the format are not
counted.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus_schema.can.frame import CanFrame
from bus_schema.configuration import ConfigurationError
from bus_schema.link.can_configuration import CanConfiguration
from bus_schema.runtime.compiled import compiled

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

_CRC15_BITS = 15
_CLASSICAL_TAIL_BITS = 13
"""CRC delimiter, ACK slot and delimiter, end of frame (7), interframe space (3)."""

_FD_TAIL_BITS = 12
_CRC17_FIELD_BITS = 4 + 17 + 6 + 1
"""Stuff count and CRC; a fixed stuff bit before them and after every fourth; the delimiter."""

_CRC21_FIELD_BITS = 4 + 21 + 7 + 1
_LARGEST_CRC17_BYTES = 16

_CRC15, _CRC15_MASK = 0x4599, 0x7FFF
_STUFFED_RUN = 5
_LONGEST_CLASSICAL_BYTES = 8
FD_LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)
_MOST_BITS = 1 + 11 + 2 + 18 + 1 + 3 + 5 + 8 * _MOST_BYTES
# Start of frame, identifier, RRS, IDE, FDF, res, BRS; then ESI and DLC.
_FD_HEAD_BITS, _FD_CONTROL_BITS = 1 + 11 + 5, 5
_LONG_IDENTIFIER_BITS = 19 + 5
"""SRR and 18 more bits of an identifier, and the most stuff bits among them."""

_RATES_HZ = (10_000, 8000, 5000, 4000, 2500, 2000, 1000, 800, 500, 400, 250, 200, 125, 100)
_LARGEST_SHARE = 0.95
"""Of the period: the rest is for heartbeats, status words and emergencies."""


class WireBits(NamedTuple):
    """Bits that a frame occupies.

    Attributes:
        nominal: bits at the nominal rate.
        fast: bits at the data rate, of FD frames.
    """

    nominal: int
    fast: int

    def duration_ns(self, bitrate: int, data_bitrate: int) -> int:
        """Time for which the frame occupies the bus, ns."""
        return round(1e9 * (self.nominal / bitrate + self.fast / data_bitrate))

    def words(self, can: CanConfiguration) -> str:
        """The bits and how long they take."""
        rates = f"{can.bitrate // 1000} kbit/s"
        bits = f"{self.nominal} bits"
        if self.fast:
            rates += f" and {(can.data_bitrate or can.bitrate) // 1000} kbit/s"
            bits += f" and {self.fast} of data"
        needed_us = 1e-3 * self.duration_ns(can.bitrate, can.data_bitrate or can.bitrate)
        return f"{bits} with stuffing = {needed_us:.0f} µs at {rates}"


class CycleFrames(NamedTuple):
    """Frames of one control cycle.

    Attributes:
        shared: data bytes of each frame that all drives share, a classical one.
        per_drive: data bytes of each frame that is sent for or by every single drive.
        words: the same in words; ``{n}`` stands for the number of drives.
        is_fd: frames of single drives are those of CAN FD.
        extended: how many frames of a single drive have 29-bit identifiers.
    """

    shared: tuple[int, ...]
    per_drive: tuple[int, ...]
    words: str
    is_fd: bool = False
    extended: int = 0


def longest_classical_bits(data_bytes: int) -> WireBits:
    """Bits of a classical frame with a standard identifier and the most stuff bits possible."""
    stuffable = 34 + 8 * data_bytes
    return WireBits(stuffable + (stuffable - 1) // 4 + _CLASSICAL_TAIL_BITS, 0)


def longest_fd_bits(data_bytes: int) -> WireBits:
    """Bits of an FD frame with a standard identifier and the most stuff bits possible.

    Args:
        data_bytes: one of the lengths that FD frames have.
    """
    early = _FD_HEAD_BITS + (_FD_HEAD_BITS - 1) // 4
    late = _FD_CONTROL_BITS + 8 * data_bytes
    crc_field = _CRC17_FIELD_BITS if data_bytes <= _LARGEST_CRC17_BYTES else _CRC21_FIELD_BITS
    return WireBits(early + _FD_TAIL_BITS, late + -(-late // 4) + crc_field)


def cycle_bits(cycle: CycleFrames, joints: int) -> WireBits:
    """Most bits that the frames of one cycle can have, stuff bits included."""
    longest = longest_fd_bits if cycle.is_fd else longest_classical_bits
    frames = [*map(longest_classical_bits, cycle.shared), *map(longest, joints * cycle.per_drive)]
    extra = joints * cycle.extended * _LONG_IDENTIFIER_BITS
    return WireBits(extra + sum(each.nominal for each in frames), sum(each.fast for each in frames))


def check_cycle_fits(
    can: CanConfiguration, cycle: CycleFrames, joints: int, rate_hz: float
) -> None:
    """Refuse a rate at which the frames of a cycle do not fit into its period.

    Raises:
        ConfigurationError: with the arithmetic, and the nearest rate that fits.
    """
    bits = cycle_bits(cycle, joints)
    needed_us = 1e-3 * bits.duration_ns(can.bitrate, can.data_bitrate or can.bitrate)
    period_us = 1e6 / rate_hz
    if needed_us <= _LARGEST_SHARE * period_us:
        return
    limit_hz = _LARGEST_SHARE * 1e6 / needed_us
    fitting = next((rate for rate in _RATES_HZ if rate <= limit_hz), int(limit_hz))
    raise ConfigurationError(
        "rate_hz", rate_hz,
        f"a cycle of {joints} drives takes {cycle.words.format(n=joints)} = up to"
        f" {bits.words(can)}, and of the period of"
        f" {period_us:.0f} µs {_LARGEST_SHARE:.0%} may be used; the nearest rate that fits is"
        f" {fitting} Hz (at most {limit_hz:.0f})", ["link.kind", "link.can", "robot"],
    )  # fmt: skip


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


class FrameBits(NamedTuple):
    """Frames as they are on the wire; all of shape (frames,).

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
    count = _put(bits, count, _crc15(bits, count), _CRC15_BITS)
    return count + _stuff_bits(bits, count, count)[0] + _CLASSICAL_TAIL_BITS


@compiled
def _crc15(bits: NDArray[np.uint8], count: int) -> int:
    crc = 0
    for index in range(count):
        flips = bits[index] != crc >> (_CRC15_BITS - 1)
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
    while FD_LENGTHS[dlc] < length:
        dlc += 1
    # IDE, of a standard frame; FDF, res, BRS: the last bit of the arbitration phase
    slow = _put(bits, head_bits, 0b101, 3 if is_extended else 4)
    count = _put(bits, slow, dlc, 5)  # ESI and DLC
    for index in range(FD_LENGTHS[dlc]):
        count = _put(bits, count, int(data[index]), 8)
    # No stuff bit comes after the last bit: the CRC field begins with a fixed one.
    early, late = _stuff_bits(bits, count - 1, slow)
    crc_field = _CRC17_FIELD_BITS if FD_LENGTHS[dlc] <= _LARGEST_CRC17_BYTES else _CRC21_FIELD_BITS
    return slow + early + _FD_TAIL_BITS, count - slow + late + crc_field


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

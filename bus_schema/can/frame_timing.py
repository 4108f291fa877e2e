"""How long CAN frames are on the wire, and whether those of a control cycle fit into its period.

The frame formats are those of ISO 11898-1, stuff bits counted.

What a frame occupies reaches from its start-of-frame bit to the end of the interframe space (three
bits), so that frames sent back to back add up.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus_schema.can.frame import CanFrame
from bus_schema.configuration import ConfigurationError
from bus_schema.link.can_configuration import CanConfiguration
from bus_schema.runtime.compiled import compiled

_CRC15 = 0x4599
_CRC15_BITS = 15
_STUFFED_RUN = 5
_FD_LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)
_LONGEST_CLASSICAL_BYTES = 8
_HALVES = struct.Struct(">II")
_LARGEST_CRC17_BYTES = 16
_EXTENDED_HEAD_BITS = 1 + 11 + 2 + 18 + 1
# CRC delimiter, ACK slot and delimiter, end of frame (7), interframe space (3)
_CLASSICAL_TAIL_BITS = 13
_FD_TAIL_BITS = 12
# Start of frame, identifier, RRS, IDE, FDF, res, BRS; then ESI and DLC.
_FD_HEAD_BITS, _FD_CONTROL_BITS = 1 + 11 + 5, 5
# Stuff count (4 bits) and CRC; a fixed stuff bit before them and after every fourth; the delimiter.
_CRC17_FIELD_BITS = 4 + 17 + 6 + 1
_CRC21_FIELD_BITS = 4 + 21 + 7 + 1
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
        """How long the frame occupies the bus."""
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
    """

    shared: tuple[int, ...]
    per_drive: tuple[int, ...]
    words: str
    is_fd: bool = False


def wire_bits(frame: CanFrame) -> WireBits:
    """Bits that `frame` occupies, including the stuff bits that its content makes necessary.

    What no controller could send, a virtual bus may carry all the same; bits and bytes beyond the
    format are not counted.
    """
    if frame.is_fd:
        return _fd_bits(frame._replace(data=frame.data[: _FD_LENGTHS[-1]]))
    return WireBits(classical_bits(frame), 0)


def classical_bits(frame: CanFrame) -> int:
    """As `wire_bits`, of a frame that is none of CAN FD."""
    head, head_bits = _arbitration(frame)
    length = 0 if frame.is_remote else min(len(frame.data), _LONGEST_CLASSICAL_BYTES)
    # IDE and r0, or r1 and r0 of an extended frame, and the DLC
    head, head_bits = head << 6 | length, head_bits + 6
    # In halves: numba takes whole numbers of 64 bits for another type than smaller ones.
    first, rest = _HALVES.unpack_from(frame.data.ljust(_LONGEST_CLASSICAL_BYTES, b"\0"))
    return _CLASSICAL_TAIL_BITS + _stuffed_classical_bits(head, head_bits, first, rest, 8 * length)


def longest_classical_bits(data_bytes: int) -> int:
    """Bits of a classical frame with a standard identifier and the most stuff bits possible."""
    stuffable = 34 + 8 * data_bytes
    return stuffable + (stuffable - 1) // 4 + _CLASSICAL_TAIL_BITS


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
    nominal, fast = sum(map(longest_classical_bits, cycle.shared)), 0
    for data_bytes in joints * cycle.per_drive:
        longest = WireBits(longest_classical_bits(data_bytes), 0)
        longest = longest_fd_bits(data_bytes) if cycle.is_fd else longest
        nominal, fast = nominal + longest.nominal, fast + longest.fast
    return WireBits(nominal, fast)


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


def arbitration_key(frame: CanFrame) -> int:
    """Sorts frames as arbitration does: the frame that sorts first wins the bus.

    The key is the arbitration field filled up to the extended format's length with what a standard
    frame has there, dominant bits: it wins over an extended one with the same base identifier.
    """
    head, head_bits = _arbitration(frame)
    return head << (_EXTENDED_HEAD_BITS - head_bits)


def _arbitration(frame: CanFrame) -> tuple[int, int]:
    """Start of frame to the remote bit, and how many bits these are."""
    remote_bit = int(frame.is_remote and not frame.is_fd)
    if frame.is_extended:
        base, rest = frame.identifier >> 18 & 0x7FF, frame.identifier & 0x3FFFF
        return (base << 2 | 0b11) << 19 | rest << 1 | remote_bit, _EXTENDED_HEAD_BITS
    return (frame.identifier & 0x7FF) << 1 | remote_bit, 1 + 11 + 1


def _fd_bits(frame: CanFrame) -> WireBits:
    dlc = next(dlc for dlc, length in enumerate(_FD_LENGTHS) if length >= len(frame.data))
    padded = frame.data.ljust(_FD_LENGTHS[dlc], b"\0")
    head, head_bits = _arbitration(frame)
    if not frame.is_extended:
        head, head_bits = head << 1, head_bits + 1  # IDE
    # FDF, res, BRS: the last bit of the arbitration phase
    head, head_bits = head << 3 | 0b101, head_bits + 3
    nominal_bits = head_bits
    # ESI and DLC
    head, head_bits = head << 5 | dlc, head_bits + 5
    bits = _unpacked(head, head_bits, padded)
    # None comes after the last bit: the CRC field begins with a fixed one.
    early, late = _stuff_bits(bits[:-1], nominal_bits)
    crc_field = _CRC17_FIELD_BITS if len(padded) <= _LARGEST_CRC17_BYTES else _CRC21_FIELD_BITS
    return WireBits(
        nominal_bits + int(early) + _FD_TAIL_BITS,
        bits.size - nominal_bits + int(late) + crc_field,
    )


def _unpacked(head: int, head_bits: int, data: bytes) -> NDArray[np.uint8]:
    """The bits of `head`, then those of `data`, most significant first."""
    value = head << 8 * len(data) | int.from_bytes(data, "big")
    bits = head_bits + 8 * len(data)
    padding = -bits % 8
    packed = (value << padding).to_bytes((bits + padding) // 8, "big")
    return np.unpackbits(np.frombuffer(packed, np.uint8))[:bits]


@compiled
def _stuffed_classical_bits(
    head: int, head_bits: int, first: int, rest: int, data_bits: int
) -> int:
    """Bits from start of frame to the end of the CRC sequence, stuff bits included.

    Args:
        head: start of frame to DLC.
        head_bits: how many bits these are.
        first: the first 32 bits of the data, filled up with zeros.
        rest: the other 32.
        data_bits: how many of them there are.
    """
    content_bits = head_bits + data_bits
    crc, stuff_bits, run, last = 0, 0, 0, 2
    for index in range(content_bits + _CRC15_BITS):
        if index < head_bits:
            bit = (head >> (head_bits - 1 - index)) & 1
        elif index < head_bits + 32 and index < content_bits:
            bit = (first >> (head_bits + 31 - index)) & 1
        elif index < content_bits:
            bit = (rest >> (head_bits + 63 - index)) & 1
        else:
            bit = (crc >> (_CRC15_BITS - 1)) & 1
        # What is shifted out while the CRC is sent itself is the CRC.
        flips = index < content_bits and bit != (crc >> (_CRC15_BITS - 1)) & 1
        crc = (crc << 1) & 0x7FFF
        if flips:
            crc ^= _CRC15
        run = run + 1 if bit == last else 1
        last = bit
        if run == _STUFFED_RUN:
            stuff_bits, run, last = stuff_bits + 1, 1, 1 - bit
    return content_bits + _CRC15_BITS + stuff_bits


@compiled
def _stuff_bits(bits: NDArray[np.uint8], boundary: int) -> tuple[int, int]:
    """Stuff bits that a sequence makes necessary, before and after a boundary."""
    early, late, run, last = 0, 0, 0, 2
    for index in range(bits.size):
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

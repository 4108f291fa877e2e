"""How long CAN frames are at most, and whether those of a control cycle fit into its period."""

from __future__ import annotations

from typing import NamedTuple

from bus_schema.can.frame_bits import (
    CLASSICAL_TAIL_BITS,
    CRC17_FIELD_BITS,
    CRC21_FIELD_BITS,
    FD_TAIL_BITS,
    LARGEST_CRC17_BYTES,
)
from bus_schema.configuration import ConfigurationError
from bus_schema.link.can_configuration import CanConfiguration

# Start of frame, identifier, RRS, IDE, FDF, res, BRS; then ESI and DLC.
_FD_HEAD_BITS, _FD_CONTROL_BITS = 1 + 11 + 5, 5
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


def longest_classical_bits(data_bytes: int) -> int:
    """Bits of a classical frame with a standard identifier and the most stuff bits possible."""
    stuffable = 34 + 8 * data_bytes
    return stuffable + (stuffable - 1) // 4 + CLASSICAL_TAIL_BITS


def longest_fd_bits(data_bytes: int) -> WireBits:
    """Bits of an FD frame with a standard identifier and the most stuff bits possible.

    Args:
        data_bytes: one of the lengths that FD frames have.
    """
    early = _FD_HEAD_BITS + (_FD_HEAD_BITS - 1) // 4
    late = _FD_CONTROL_BITS + 8 * data_bytes
    crc_field = CRC17_FIELD_BITS if data_bytes <= LARGEST_CRC17_BYTES else CRC21_FIELD_BITS
    return WireBits(early + FD_TAIL_BITS, late + -(-late // 4) + crc_field)


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

"""Frame lengths against the formula and against a second implementation that writes out each bit.

The second one works on strings of bits and takes its rules straight from the pictures of frame
formats in Bosch's CAN Specification 2.0 (3.1, 5) and ISO 11898-1:2015 (10.4, 10.5): it shares no
code and no representation with the one under test.
"""

from __future__ import annotations

import random
import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bus_schema.can_bits import arbitration_key, longest_classical_bits, wire_bits
from bus_schema.can_frame import CanFrame

FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)


def field(value: int, width: int) -> str:
    return format(value, f"0{width}b")


def crc15(bits: str) -> str:
    """Remainder of the division by x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1."""
    generator = int("1100010110011001", 2)
    value = int(bits + "0" * 15, 2)
    while value.bit_length() > 15:
        value ^= generator << (value.bit_length() - 16)
    return field(value, 15)


def stuffed(bits: str) -> str:
    """After each five equal bits the opposite one; an inserted bit counts for the next five."""
    out, since = "", 0
    for bit in bits:
        out += bit
        if re.search(r"(0{5}|1{5})$", out[since:]):
            since = len(out)
            out += "1" if bit == "0" else "0"
    return out


def classical(frame: CanFrame) -> str:
    """A classical frame from start of frame to the end of the interframe space, as sent."""
    remote = "1" if frame.is_remote else "0"
    data = b"" if frame.is_remote else frame.data
    if frame.is_extended:
        text = field(frame.identifier, 29)
        head = "0" + text[:11] + "11" + text[11:] + remote + "00"
    else:
        head = "0" + field(frame.identifier, 11) + remote + "00"
    covered = head + field(len(data), 4) + "".join(field(byte, 8) for byte in data)
    return stuffed(covered + crc15(covered)) + "1" + "01" + "1111111" + "111"


def fd_lengths(frame: CanFrame) -> tuple[int, int]:
    """Bits of an FD frame at the nominal rate and at the data rate."""
    dlc = min(index for index, length in enumerate(FD_LENGTHS) if length >= len(frame.data))
    data = frame.data + b"\0" * (FD_LENGTHS[dlc] - len(frame.data))
    if frame.is_extended:
        text = field(frame.identifier, 29)
        slow = "0" + text[:11] + "11" + text[11:] + "0" + "101"
    else:
        slow = "0" + field(frame.identifier, 11) + "00" + "101"
    fast = "0" + field(dlc, 4) + "".join(field(byte, 8) for byte in data)
    slow_sent = stuffed(slow)
    # where the CRC field begins, its fixed stuff bit stands in for a dynamic one
    sent = stuffed((slow + fast)[:-1]) + fast[-1]
    crc_field = 5 + 4 * 5 + 2 + 1 if len(data) <= 16 else 5 + 5 * 5 + 2 + 1
    return len(slow_sent) + 2 + 7 + 3, len(sent) - len(slow_sent) + crc_field


frames = st.builds(
    lambda extended, identifier, data, remote: CanFrame(
        identifier if extended else identifier & 0x7FF, b"" if remote else data, extended, remote
    ),
    st.booleans(),
    st.integers(0, (1 << 29) - 1),
    st.binary(max_size=8)
    | st.integers(0, 8).map(bytes)
    | st.integers(0, 8).map(lambda n: b"\xff" * n),
    st.booleans(),
)


@settings(deadline=None)  # the first call compiles
@given(frames)
def test_classical_frame_is_as_long_as_its_bits_written_out(frame: CanFrame) -> None:
    assert wire_bits(frame) == (len(classical(frame)), 0)


@settings(deadline=None)  # the first call compiles
@given(st.booleans(), st.integers(0, (1 << 29) - 1), st.binary(max_size=64) | st.just(bytes(64)))
def test_fd_frame_is_as_long_as_its_bits_written_out(
    extended: bool, identifier: int, data: bytes
) -> None:
    frame = CanFrame(identifier if extended else identifier & 0x7FF, data, extended, is_fd=True)
    assert wire_bits(frame) == fd_lengths(frame)


@pytest.mark.parametrize("data_bytes", range(9))
@pytest.mark.parametrize(("extended", "fixed_bits"), [(False, 47), (True, 67)])
def test_length_lies_between_the_formulas_of_no_and_most_stuffing(
    data_bytes: int, extended: bool, fixed_bits: int
) -> None:
    """g + 8 s + 13 and, per Davis et al. 2007 (equation 1), at most ⌊(g + 8 s − 1)/4⌋ more."""
    random.seed(data_bytes)
    shortest = fixed_bits + 8 * data_bytes
    longest = shortest + (shortest - 13 - 1) // 4
    for _ in range(300):
        identifier = random.getrandbits(29 if extended else 11)
        frame = CanFrame(identifier, random.randbytes(data_bytes), extended)
        assert shortest <= wire_bits(frame).nominal <= longest
    if not extended:
        assert longest_classical_bits(data_bytes) == longest


def test_lower_identifier_wins_then_data_over_remote_then_standard_over_extended() -> None:
    low, high = CanFrame(0x181), CanFrame(0x182)
    remote = CanFrame(0x181, is_remote=True)
    extended = CanFrame(0x181 << 18, is_extended=True)
    extended_remote = CanFrame(0x181 << 18, is_extended=True, is_remote=True)
    order = [low, remote, extended, extended_remote, high]
    shuffled = [high, extended, low, extended_remote, remote]
    assert sorted(shuffled, key=arbitration_key) == order


def test_duration_counts_each_phase_at_its_own_rate() -> None:
    bits = wire_bits(CanFrame(0x123, bytes(range(64)), is_fd=True))
    expected_ns = 1e9 * (bits.nominal / 500_000 + bits.fast / 2_000_000)
    assert bits.duration_ns(500_000, 2_000_000) == round(expected_ns)

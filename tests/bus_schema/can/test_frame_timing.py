"""Frame lengths against the formula and against frames written out bit by bit."""

from __future__ import annotations

import pytest
from bit_strings import FD_LENGTHS, classical, fd_lengths
from hypothesis import given
from hypothesis import strategies as st

from bus_schema.can.frame import CanFrame
from bus_schema.can.frame_timing import (
    WireBits,
    count_bits,
    frame_table,
    longest_classical_bits,
    longest_fd_bits,
)

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


def wire_bits(frame: CanFrame) -> WireBits:
    bits = count_bits(frame_table([frame]))
    return WireBits(int(bits.nominal[0]), int(bits.fast[0]))


@given(frames)
def test_classical_frame_is_as_long_as_its_bits_written_out(frame: CanFrame) -> None:
    assert wire_bits(frame) == (len(classical(frame)), 0)


@given(st.booleans(), st.integers(0, (1 << 29) - 1), st.binary(max_size=64) | st.just(bytes(64)))
def test_fd_frame_is_as_long_as_its_bits_written_out(extended, identifier, data):
    frame = CanFrame(identifier if extended else identifier & 0x7FF, data, extended, is_fd=True)
    assert wire_bits(frame) == fd_lengths(frame)


def test_lower_identifier_wins_then_data_over_remote_then_standard_over_extended() -> None:
    low, high = CanFrame(0x181), CanFrame(0x182)
    remote = CanFrame(0x181, is_remote=True)
    extended = CanFrame(0x181 << 18, is_extended=True)
    extended_remote = CanFrame(0x181 << 18, is_extended=True, is_remote=True)
    order = [low, remote, extended, extended_remote, high]
    shuffled = [high, extended, low, extended_remote, remote]
    keys = count_bits(frame_table(shuffled)).arbitration
    assert [shuffled[index] for index in keys.argsort()] == order


@given(st.lists(frames, min_size=2, max_size=9))
def test_frames_count_the_same_alone_and_among_others(together: list[CanFrame]) -> None:
    counted = count_bits(frame_table(together))
    alone = [count_bits(frame_table([frame])) for frame in together]
    for all_of_them, ones in zip(counted, zip(*alone, strict=True), strict=True):
        assert all_of_them.tolist() == [int(each[0]) for each in ones]


@pytest.mark.parametrize("is_fd", [False, True])
def test_bytes_beyond_the_format_are_not_counted(is_fd: bool) -> None:
    most = 64 if is_fd else 8
    whole, more = (CanFrame(1 << 40 | 0x123, bytes(n), is_fd=is_fd) for n in (most, most + 300))
    assert wire_bits(more) == wire_bits(whole._replace(identifier=0x123))


@given(st.integers(0, 0x7FF), st.sampled_from(FD_LENGTHS), st.sampled_from((0x00, 0xFF, 0x0F)))
def test_no_frame_is_longer_than_the_longest(identifier, data_bytes, filling):
    """Of a classical one, by Davis et al. 2007 (equation 1): ⌊(g + 8 s − 1)/4⌋ stuff bits."""
    data = bytes([filling]) * data_bytes
    bits, longest = wire_bits(CanFrame(identifier, data, is_fd=True)), longest_fd_bits(data_bytes)
    assert bits.nominal <= longest.nominal
    assert 0.75 * longest.fast <= bits.fast <= longest.fast
    if data_bytes <= 8:
        most = longest_classical_bits(data_bytes).nominal
        assert most == 47 + 8 * data_bytes + (34 + 8 * data_bytes - 1) // 4
        assert wire_bits(CanFrame(identifier, data)).nominal <= most

"""The medium: who goes first, how long it takes, how full the bus is, and what does not fit."""

from __future__ import annotations

import random
import subprocess
import sys

import pytest
from bit_strings import classical

from bus_schema.can.cia402_codec import Cia402Codec
from bus_schema.can.frame import CanFrame
from bus_schema.can.frame_timing import check_cycle_fits, cycle_bits
from bus_schema.can.medium import CanMedium
from bus_schema.configuration import ConfigurationError
from bus_schema.link.can_configuration import CanConfiguration, CanFaults

MS = 1_000_000


def three_drive_cycle(chance: random.Random) -> list[list[CanFrame]]:
    """SYNC, then three states at once, then three torques at once, with random contents."""
    return [
        [CanFrame(0x080)],
        [CanFrame(0x180 + node, chance.randbytes(8)) for node in (3, 1, 2)],
        [CanFrame(0x200 + node, chance.randbytes(4)) for node in (2, 3, 1)],
    ]


@pytest.mark.parametrize("bitrate", [125_000, 500_000, 1_000_000])
def test_load_of_a_three_drive_cycle_is_that_of_its_bits(bitrate: int) -> None:
    chance, medium, bits = random.Random(7), CanMedium(CanConfiguration(bitrate=bitrate), 0), 0
    ticks, period_ns = 200, 10 * MS
    for tick in range(ticks):
        for frames in three_drive_cycle(chance):
            medium.transmit(frames, max(tick * period_ns, medium.free_ns))
            bits += sum(len(classical(frame)) for frame in frames)
    summary = medium.summary(ticks * period_ns)
    assert summary["load"] == pytest.approx(bits / bitrate / (ticks * period_ns * 1e-9), rel=0.01)
    assert summary["frames"] == 7 * ticks
    assert summary["frames_by_identifier"]["181"] == ticks


def test_frames_that_wait_together_go_by_identifier() -> None:
    medium = CanMedium(CanConfiguration(), 0)
    passed = medium.transmit([CanFrame(0x203), CanFrame(0x181), CanFrame(0x202)], 1000)
    assert [frame.identifier for _, frame in passed] == [0x181, 0x202, 0x203]
    ends_ns = [end_ns for end_ns, _ in passed]
    lengths = [len(classical(frame)) * 1000 for _, frame in passed]  # a bit lasts 1000 ns
    assert ends_ns == [1000 + sum(lengths[:n]) for n in (1, 2, 3)]
    assert medium.worst_latency_ns == sum(lengths)


def test_frame_that_finds_the_bus_busy_waits_whatever_its_identifier() -> None:
    medium = CanMedium(CanConfiguration(), 0)
    ((first_ns, _),) = medium.transmit([CanFrame(0x700, bytes(8))], 0)
    ((second_ns, _),) = medium.transmit([CanFrame(0x080)], 1000)
    assert second_ns == first_ns + 1000 * len(classical(CanFrame(0x080)))


def test_overload_shows_as_load_above_one() -> None:
    medium = CanMedium(CanConfiguration(bitrate=125_000), 0)
    for tick in range(100):
        for frames in three_drive_cycle(random.Random(tick)):
            medium.transmit(frames, max(tick * MS, medium.free_ns))
    assert medium.summary(100 * MS)["load"] > 4.0
    assert medium.worst_latency_ns < 100 * MS


def test_error_frames_cost_time_and_come_as_often_as_asked_for() -> None:
    faults = CanFaults(frame_error_probability=0.2)
    medium, clean = CanMedium(CanConfiguration(faults=faults), 3), CanMedium(CanConfiguration(), 3)
    frame = CanFrame(0x181, b"\x55" * 8)
    for each in (medium, clean):
        for _ in range(2000):
            each.transmit([frame], each.free_ns)
    # each attempt fails with 0.2: 0.25 failures for each success; 5 standard deviations
    assert medium.error_frames == pytest.approx(500, abs=5 * 25)
    wasted_bits = (medium.free_ns - clean.free_ns) / 1000 / medium.error_frames
    # on average half of the frame, a flag of 6 to 12 bits, delimiter and interframe space
    half = len(classical(frame)) / 2
    assert half + 8 + 3 + 6 - 8 < wasted_bits < half + 8 + 3 + 12 + 8


def test_seven_drives_at_1_khz_are_refused_with_the_arithmetic() -> None:
    """SYNC 55 bits, TPDO 135 and RPDO 95 with all stuff bits: 55 + 7 · 230 = 1665 in 1000 µs."""
    with pytest.raises(ConfigurationError) as refusal:
        check_cycle_fits(CanConfiguration(), Cia402Codec.cycle, 7, 1000.0)
    message = str(refusal.value)
    assert "rate_hz = 1000.0" in message
    assert "1665 bits" in message
    assert "period of 1000 µs" in message
    assert "nearest rate that fits is 500 Hz (at most 571)" in message
    check_cycle_fits(CanConfiguration(), Cia402Codec.cycle, 7, 570.0)
    check_cycle_fits(CanConfiguration(), Cia402Codec.cycle, 3, 1000.0)


def test_budget_is_the_longest_that_a_cycle_can_be() -> None:
    budget = cycle_bits(Cia402Codec.cycle, 3).nominal
    chance = random.Random(1)
    longest = max(
        sum(len(classical(frame)) for frames in three_drive_cycle(chance) for frame in frames)
        for _ in range(300)
    )
    assert 0.8 * budget < longest <= budget


NEW_MEDIUM = """
from bus_schema.can import frame_timing
from bus_schema.can.medium import CanMedium
from bus_schema.link.can_configuration import CanConfiguration

CanMedium(CanConfiguration(), 0)
kernels = frame_timing._stuffed_classical_bits, frame_timing._stuff_bits
print(*(len(kernel.signatures) for kernel in kernels))
"""


def test_nothing_is_left_to_be_compiled_while_the_bus_is_in_use() -> None:
    # Compiling takes seconds, on a busy machine more than the loops wait for each other.
    told = subprocess.run([sys.executable, "-c", NEW_MEDIUM], capture_output=True, text=True)
    assert (told.stdout.split(), told.stderr) == (["1", "1"], "")

"""The medium: order and times of frames, load, and cycles that do not fit."""

from __future__ import annotations

import random
import subprocess
import sys
from collections.abc import Iterable

import numpy as np
import pytest
from bit_strings import classical
from numpy.typing import NDArray

from bus_schema.can.cia402.codec import TORQUE
from bus_schema.can.frame import CanFrame
from bus_schema.can.frame_timing import check_cycle_fits
from bus_schema.can.medium import CandumpLog, CanMedium
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
            medium.carry(frames, tick * period_ns)
            bits += sum(len(classical(frame)) for frame in frames)
    summary = medium.summary(ticks * period_ns)
    assert summary["load"] == pytest.approx(bits / bitrate / (ticks * period_ns * 1e-9), rel=0.01)
    assert summary["frames"] == 7 * ticks
    assert summary["frames_by_identifier"]["181"] == ticks


class Passed(CandumpLog):
    """A log in memory: what was through on the bus, and when."""

    def __init__(self) -> None:
        self.identifiers: list[int] = []
        self.contents: list[bytes] = []
        self.ends_ns: list[int] = []

    def write(self, times_ns: NDArray[np.int64], frames: Iterable[CanFrame]) -> None:
        self.ends_ns += times_ns.tolist()
        for frame in frames:
            self.identifiers.append(frame.identifier)
            self.contents.append(frame.data)


def test_frames_that_wait_together_go_by_identifier() -> None:
    passed = Passed()
    medium = CanMedium(CanConfiguration(), 0, passed)
    frames = [CanFrame(0x203), CanFrame(0x181, b"12345678"), CanFrame(0x202)]
    medium.carry(frames, 1000)
    medium.settle()
    assert passed.identifiers == [0x181, 0x202, 0x203]
    lengths = [len(classical(frames[index])) * 1000 for index in (1, 2, 0)]  # a bit lasts 1000 ns
    assert passed.ends_ns == [1000 + sum(lengths[:n]) for n in (1, 2, 3)]
    assert medium.worst_latency_ns == sum(lengths)


def test_frame_on_a_busy_bus_waits_with_any_identifier() -> None:
    passed = Passed()
    medium = CanMedium(CanConfiguration(), 0, passed)
    medium.carry([CanFrame(0x700, bytes(8))], 0)
    medium.carry([CanFrame(0x080)], 1000)
    medium.settle()
    first_ns, second_ns = passed.ends_ns
    assert second_ns == first_ns + 1000 * len(classical(CanFrame(0x080)))


def test_settling_at_any_time_gives_the_same_times() -> None:
    chance = random.Random(5)
    sent = [(tick * 7 * MS, frames) for tick in range(300) for frames in three_drive_cycle(chance)]
    logs, summaries = [], []
    for settles in (lambda: True, lambda: chance.random() < 0.1, lambda: False):
        faults, passed = CanFaults(frame_error_probability=0.2), Passed()
        medium = CanMedium(CanConfiguration(bitrate=125_000, faults=faults), 1, passed)
        for now_ns, frames in sent:
            medium.carry(frames, now_ns)
            if settles():
                medium.settle()
        summaries.append(medium.summary(sent[-1][0]))
        logs.append(list(zip(passed.ends_ns, passed.identifiers, passed.contents, strict=True)))
    assert summaries[0] == summaries[1] == summaries[2]
    assert logs[0] == logs[1] == logs[2]
    assert len(logs[0]) == 7 * 300


def test_flood_of_identifiers_is_counted_but_not_by_name() -> None:
    medium = CanMedium(CanConfiguration(), 0)
    for identifier in range(3000):
        medium.carry([CanFrame(identifier, is_extended=True)], 0)
    summary = medium.summary(MS)
    assert summary["frames"] == 3000
    assert len(summary["frames_by_identifier"]) == 1001
    assert summary["frames_by_identifier"]["others"] == 2000


def test_error_frames_take_time_and_have_the_configured_rate() -> None:
    faults = CanFaults(frame_error_probability=0.2)
    medium, clean = CanMedium(CanConfiguration(faults=faults), 3), CanMedium(CanConfiguration(), 3)
    frame = CanFrame(0x181, b"\x55" * 8)
    for each in (medium, clean):
        for _ in range(2000):
            each.carry([frame], 0)
        each.settle()
    # each attempt fails with 0.2: 0.25 failures for each success; 5 standard deviations
    assert medium.error_frames == pytest.approx(500, abs=5 * 25)
    wasted_bits = (medium.free_ns - clean.free_ns) / 1000 / medium.error_frames
    # on average half of the frame, a flag of 6 to 12 bits, delimiter and interframe space
    half = len(classical(frame)) / 2
    assert half + 8 + 3 + 6 - 8 < wasted_bits < half + 8 + 3 + 12 + 8


def test_seven_drives_at_1_khz_are_refused_with_the_arithmetic() -> None:
    """SYNC 55 bits, TPDO 135 and RPDO 95 with all stuff bits: 55 + 7 · 230 = 1665 in 1000 µs."""
    with pytest.raises(ConfigurationError) as refusal:
        check_cycle_fits(CanConfiguration(), TORQUE.cycle, 7, 1000.0)
    message = str(refusal.value)
    assert "rate_hz = 1000.0" in message
    assert "1665 bits" in message
    assert "period of 1000 µs" in message
    assert "nearest rate that fits is 500 Hz (at most 571)" in message
    check_cycle_fits(CanConfiguration(), TORQUE.cycle, 7, 570.0)
    check_cycle_fits(CanConfiguration(), TORQUE.cycle, 3, 1000.0)


NEW_MEDIUM = """
from bus_schema.can.frame_timing import _count
from bus_schema.can.medium import CanMedium
from bus_schema.link.can_configuration import CanConfiguration
from bus_schema.can.frame import CanFrame

medium = CanMedium(CanConfiguration(), 0)
before = len(_count.signatures)
medium.carry([CanFrame(0x10, bytes(64), True, is_fd=True), CanFrame(0x10, bytes(3))], 0)
medium.settle()
print(before, len(_count.signatures))
"""


def test_bit_counter_is_compiled_before_the_bus_is_used() -> None:
    # Compiling takes seconds, on a busy machine more than the loops wait for each other.
    done = subprocess.run([sys.executable, "-c", NEW_MEDIUM], capture_output=True, text=True)
    assert (done.stdout.split(), done.stderr) == (["1"] * 2, "")

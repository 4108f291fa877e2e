"""A frame that is no command of a drive's dialect is counted, and moves nothing."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest
from dialects import DIALECTS
from drive_bench import NODE, Bank

from bus_schema.can.frame import CanFrame
from bus_schema.can.mit.codec import MitCommand, MitRanges, ending_of, packed_command
from bus_schema.can.mit.protocol import MitProtocol
from bus_schema.link.can_configuration import CanConfiguration
from plant_emulator.drives.cansimple.drive import load_database
from tests.arms import PAPER_ARM

LIMIT_NM = 9.0
FULL = MitCommand(1e9, 1e9, 1e9, 1e9, 1e9)
NO_NUMBERS = (struct.pack("<f", math.nan), struct.pack("<f", math.inf))


def following(protocol):
    """A drive that follows a torque of 1 N m."""
    bank = Bank(protocol, nodes=(NODE,), most_nm=LIMIT_NM)
    bank.enable(1.0)
    assert 0.0 < bank.torque_nm < LIMIT_NM
    assert not bank.bank.rejections.counts
    return bank


def unknown_endings(known, *offsets):
    for ending in sorted(set(range(256)) - set(known)):
        for offset in offsets:
            yield CanFrame(NODE + offset, bytes([255] * 7 + [ending]))


def no_mit_commands():
    """Only classical data frames of eight bytes are commands."""
    for length in (*range(8), 12, 64):
        yield CanFrame(NODE, bytes(length), is_fd=length > 8)
    for flag in ("is_extended", "is_remote", "is_fd"):
        yield CanFrame(NODE, bytes(8), **{flag: True})


def of_mit():
    yield from unknown_endings({0xFC, 0xFD, 0xFE}, 0)
    yield from no_mit_commands()


def of_damiao():
    yield from unknown_endings({0xFB, 0xFC, 0xFD, 0xFE}, 0, 0x100, 0x200, 0x300)
    yield from no_mit_commands()
    for request in sorted(set(range(256)) - {0x33, 0x55, 0xAA, 0xCC}):
        yield CanFrame(0x7FF, bytes([NODE, 0, request, 0, 0, 0, 0, 0]))
    for length in (*range(8), 12, 64):
        yield CanFrame(0x7FF, bytes([NODE, 0, 0xCC, *bytes(61)])[:length])


def of_cansimple():
    def frame(command, data=b"", **flags):
        return CanFrame(NODE << 5 | command, data, **flags)

    known = {each.frame_id for each in load_database().messages}
    unused = {0x04, 0x05, 0x11, 0x12, 0x13, 0x1F}  # SDO, trajectories, DFU
    for command in sorted(set(range(32)) - known | unused):
        yield from (frame(command, b"\xff" * length) for length in range(9))
    for command, needed in ((7, 4), (11, 8), (12, 8), (13, 8), (14, 4), (15, 8), (26, 4), (27, 8)):
        yield from (frame(command, bytes(length)) for length in range(needed))
        yield frame(command, is_remote=True)
    yield from (frame(14, number) for number in NO_NUMBERS)
    yield frame(12, NO_NUMBERS[0] + bytes(4))
    yield frame(9, bytes(8))  # estimates, which only an axis sends
    yield frame(15, struct.pack("<ff", -1.0, 1.0))  # limits
    yield frame(0x16, b"\x03")  # a reboot that does not exist
    yield frame(26, struct.pack("<f", -1.0))  # gains
    yield frame(27, struct.pack("<ff", 1.0, -1.0))


def of_cia402():
    for length in range(4):
        yield CanFrame(0x200 + NODE, b"\xff" * length)  # RPDO 1 has four bytes
    for length in (0, 1, 3, 8):
        yield CanFrame(0, b"\x02" * length)  # NMT has two
    for command in sorted(set(range(256)) - {1, 2, 128, 129, 130}):
        yield CanFrame(0, bytes([command, 0]))
    for length in range(8):
        yield CanFrame(0x600 + NODE, b"\x2f" * length)


def of_moteus():
    command = DIALECTS["moteus"].torque(NODE, 1.0).data
    starts = {place for place in range(256) if place & 0xF0 in (0x00, 0x10)} | {0x50}
    for kind in sorted(set(range(256)) - starts):
        yield CanFrame(NODE, bytes([kind]) + bytes(11))
    whole = {0, 3, 26, 32}  # nothing, the mode alone, and what has all its floats
    for length in sorted(set(range(len(command))) - whole):
        yield CanFrame(NODE, command[:length])
    for number in (*NO_NUMBERS, struct.pack("<f", -math.inf)):
        yield CanFrame(NODE, command.replace(struct.pack("<f", 1.0), number, 1))
    for mode in set(range(256)) - {0, 10, 12}:
        yield CanFrame(NODE, bytes([0x01, 0x00, mode]))
    yield CanFrame(NODE, is_remote=True)


def for_others():
    own = {0, 0x080, 0x700, NODE, *range(NODE << 5, (NODE << 5) + 32)}
    own |= {base + NODE for base in range(0x100, 0x800, 0x80)} | {0x100 + NODE, 0x7FF}
    for identifier in sorted(set(range(0x800)) - own):
        yield CanFrame(identifier, b"\xff" * 8)


OWN = {"mit": of_mit, "damiao": of_damiao, "cansimple": of_cansimple, "cia402": of_cia402,
       "moteus": of_moteus}  # fmt: skip
UNKNOWN = [*OWN.items(), *((each, for_others) for each in OWN if each != "moteus")]


@pytest.mark.parametrize(("protocol", "frames"), UNKNOWN)
def test_frame_that_is_no_command_is_counted_and_moves_nothing(protocol, frames):
    bank, unknown = following(protocol), list(frames())
    assert len(unknown) > 30
    for frame in unknown:
        bank.assert_refused(frame)


@pytest.mark.parametrize("mode", [2, 3, 4])
def test_damiao_refuses_targets_that_are_cut_short_or_no_numbers(mode):
    bank = following("damiao")
    bank.send(CanFrame(0x7FF, struct.pack("<HBBI", NODE, 0x55, 10, mode)))
    offset, whole = (mode - 1) << 8, (4, 8) if mode == 3 else (8,)
    bank.send(CanFrame(NODE + offset, struct.pack("<f", 0.0) + bytes(max(whole) - 4)))
    for length in set(range(9)) - {*whole}:
        bank.assert_refused(CanFrame(NODE + offset, bytes(length)))
    for number in NO_NUMBERS:
        bank.assert_refused(CanFrame(NODE + offset, number + bytes(4)))


def test_mit_codec_tells_commands_from_special_frames():
    codec = MitProtocol().codec(CanConfiguration(protocol="mit"), PAPER_ARM)
    torque_nm = [0.0, 0.0, 0.0]
    for ending in range(256):
        assert codec.read_torque(CanFrame(1, bytes([255] * 7 + [ending])), torque_nm) is None
    assert torque_nm == [0.0, 0.0, 0.0]
    data = packed_command(FULL, MitRanges())  # all its numbers at their upper ends
    assert ending_of(data) is None
    assert codec.read_torque(CanFrame(1, data), torque_nm) == 0
    assert torque_nm == [18.0, 0.0, 0.0]


def test_cia402_aborts_every_sdo_command_that_it_does_not_have():
    bank = following("cia402")
    before_nm = bank.torque_nm
    for rest in range(32):
        (answer,) = bank.send(CanFrame(0x600 + NODE, bytes([7 << 5 | rest]) + b"\xff" * 7))
        assert answer.data[0] == 0x80
    assert bank.torque_nm == before_nm
    assert not bank.bank.rejections.counts


def test_no_random_frame_gets_more_torque_from_a_moteus_than_it_has():
    bank, command = following("moteus"), DIALECTS["moteus"].torque(NODE, 1.0).data
    random = np.random.default_rng(1)
    for _ in range(5000):
        data = bytearray(command if random.random() < 0.5 else random.bytes(random.integers(64)))
        if data:
            data[random.integers(len(data))] = random.integers(256)
        bank.send(CanFrame(NODE, bytes(data)))
        assert abs(bank.torque_nm) <= LIMIT_NM
        assert not (bank.bank.braked[0] and bank.torque_nm)

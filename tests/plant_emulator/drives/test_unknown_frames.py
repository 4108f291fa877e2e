"""A frame that is no command of a drive's dialect is counted, and moves nothing."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest
from dialects import DIALECTS

from bus_schema.can.frame import CanFrame
from bus_schema.can.mit.codec import MitCommand, MitRanges, ending_of, packed_command
from bus_schema.can.mit.protocol import MitProtocol
from bus_schema.link.can_configuration import CanConfiguration
from plant_emulator.drives.bank import DriveBank
from plant_emulator.drives.cansimple.drive import load_database
from tests.arms import PAPER_ARM

NODE, LIMIT_NM = 5, 9.0
FULL = MitCommand(1e9, 1e9, 1e9, 1e9, 1e9)


class Bank:
    """One drive that follows a torque, and its bank, which counts what it refuses."""

    def __init__(self, protocol):
        self.sent, dialect = [], DIALECTS[protocol]
        settings = dialect.settings(NODE, LIMIT_NM)
        self.bank = DriveBank(dialect.drive, [settings], self.sent.append)
        self.bank.advance(0)
        for frame in (*dialect.start(NODE), dialect.torque(NODE, 1.0)):
            self.bank.receive(frame, 0)
        self.torque_nm = float(self.bank.torque_nm[0])
        assert 0.0 < self.torque_nm < LIMIT_NM
        assert not self.bank.rejections.counts

    def hear(self, identifier, data=b"", **flags):
        """Whether it takes the frame."""
        before = sum(self.bank.rejections.counts.values())
        self.bank.receive(CanFrame(identifier, data, **flags), 0)
        return sum(self.bank.rejections.counts.values()) == before

    def assert_refused(self, identifier, data=b"", **flags):
        assert not self.hear(identifier, data, **flags), (hex(identifier), data, flags)
        assert float(self.bank.torque_nm[0]) == self.torque_nm
        assert not self.bank.braked[0]


def test_mit_takes_none_of_the_special_frames_that_it_does_not_have():
    bank = Bank("mit")
    for ending in sorted(set(range(256)) - {0xFC, 0xFD, 0xFE}):
        bank.assert_refused(NODE, bytes([255] * 7 + [ending]))
    assert bank.bank.rejections.counts == {"no_command": 253}


@pytest.mark.parametrize("offset", [0, 0x100, 0x200, 0x300])
def test_damiao_takes_none_of_the_special_frames_that_it_does_not_have(offset):
    bank = Bank("damiao")
    for ending in sorted(set(range(256)) - {0xFB, 0xFC, 0xFD, 0xFE}):
        bank.assert_refused(NODE + offset, bytes([255] * 7 + [ending]))
    assert bank.bank.rejections.counts == {"no_command": 252}


def test_damiao_refuses_requests_that_it_does_not_have():
    bank = Bank("damiao")
    for request in sorted(set(range(256)) - {0x33, 0x55, 0xAA, 0xCC}):
        bank.assert_refused(0x7FF, bytes([NODE, 0, request, 0, 0, 0, 0, 0]))
    for length in (*range(8), 12, 64):
        bank.assert_refused(0x7FF, bytes([NODE, 0, 0xCC, *bytes(61)])[:length])


@pytest.mark.parametrize("mode", [2, 3, 4])
def test_damiao_refuses_targets_that_are_cut_short_or_no_numbers(mode):
    bank = Bank("damiao")
    bank.hear(0x7FF, struct.pack("<HBBI", NODE, 0x55, 10, mode))
    offset, whole = (mode - 1) << 8, (4, 8) if mode == 3 else (8,)
    bank.hear(NODE + offset, struct.pack("<f", 0.0) + bytes(max(whole) - 4))
    bank.torque_nm = float(bank.bank.torque_nm[0])
    for length in set(range(9)) - {*whole}:
        bank.assert_refused(NODE + offset, bytes(length))
    for number in (b"\x00\x00\xc0\x7f", b"\x00\x00\x80\x7f"):  # not a number, infinite
        bank.assert_refused(NODE + offset, number + bytes(4))


@pytest.mark.parametrize("protocol", ["mit", "damiao"])
def test_only_classical_data_frames_of_eight_bytes_are_commands(protocol):
    bank = Bank(protocol)
    for length in (*range(8), 12, 64):
        bank.assert_refused(NODE, bytes(length), is_fd=length > 8)
    for flag in ("is_extended", "is_remote", "is_fd"):
        bank.assert_refused(NODE, bytes(8), **{flag: True})


def test_mit_command_at_all_its_upper_ends_is_no_special_frame():
    data = packed_command(FULL, MitRanges())
    assert ending_of(data) is None
    codec = MitProtocol().codec(CanConfiguration(protocol="mit"), PAPER_ARM)
    torque_nm = [0.0, 0.0, 0.0]
    assert codec.read_torque(CanFrame(1, data), torque_nm) == 0
    assert torque_nm == [18.0, 0.0, 0.0]


def test_mit_codec_reads_no_torque_from_a_special_frame():
    codec = MitProtocol().codec(CanConfiguration(protocol="mit"), PAPER_ARM)
    torque_nm = [0.0, 0.0, 0.0]
    for ending in range(256):
        assert codec.read_torque(CanFrame(1, bytes([255] * 7 + [ending])), torque_nm) is None
    assert torque_nm == [0.0, 0.0, 0.0]


def test_cansimple_refuses_commands_that_it_does_not_have_and_those_cut_short():
    bank = Bank("cansimple")
    known = {each.frame_id for each in load_database().messages}
    unused = {0x04, 0x05, 0x11, 0x12, 0x13, 0x1F}  # SDO, trajectories, DFU
    for command in sorted(set(range(32)) - known | unused):
        for length in range(9):
            bank.assert_refused(NODE << 5 | command, b"\xff" * length)
    for command, needed in ((7, 4), (11, 8), (12, 8), (13, 8), (14, 4), (15, 8), (26, 4), (27, 8)):
        for length in range(needed):
            bank.assert_refused(NODE << 5 | command, bytes(length))
        bank.assert_refused(NODE << 5 | command, is_remote=True)
    for text in (b"\x00\x00\xc0\x7f", b"\x00\x00\x80\x7f"):  # not a number, infinite
        bank.assert_refused(NODE << 5 | 14, text)


def test_cia402_refuses_what_is_no_command():
    bank = Bank("cia402")
    for length in range(4):
        bank.assert_refused(0x200 + NODE, b"\xff" * length)  # RPDO 1 has four bytes
    for length in (0, 1, 3, 8):
        bank.assert_refused(0, b"\x02" * length)  # NMT has two
    for command in sorted(set(range(256)) - {1, 2, 128, 129, 130}):
        bank.assert_refused(0, bytes([command, 0]))
    for length in range(8):
        bank.assert_refused(0x600 + NODE, b"\x2f" * length)


def test_cia402_aborts_every_sdo_command_that_it_does_not_have():
    bank = Bank("cia402")
    for specifier in range(7, 8):
        for rest in range(32):
            bank.sent.clear()
            assert bank.hear(0x600 + NODE, bytes([specifier << 5 | rest]) + b"\xff" * 7)
            assert [frame.data[0] for frame in bank.sent] == [0x80]
            assert float(bank.bank.torque_nm[0]) == bank.torque_nm


def moteus():
    return Bank("moteus"), DIALECTS["moteus"].torque(NODE, 1.0).data


def test_moteus_refuses_subframes_that_it_does_not_have_and_commands_cut_short():
    bank, command = moteus()
    starts = {place for place in range(256) if place & 0xF0 in (0x00, 0x10)} | {0x50}
    for kind in sorted(set(range(256)) - starts):
        bank.assert_refused(NODE, bytes([kind]) + bytes(11))
    whole = {0, 3, 26, 32}  # nothing, the mode alone, and what has all its floats
    for length in sorted(set(range(len(command))) - whole):
        bank.assert_refused(NODE, command[:length])
    for number in (math.nan, math.inf, -math.inf):
        data = command.replace(struct.pack("<f", 1.0), struct.pack("<f", number), 1)
        bank.assert_refused(NODE, data)
    for mode in set(range(256)) - {0, 10, 12}:
        bank.assert_refused(NODE, bytes([0x01, 0x00, mode]))
    bank.assert_refused(NODE, is_remote=True)


def test_no_random_frame_gets_more_torque_from_a_moteus_than_it_has():
    bank, command = moteus()
    random = np.random.default_rng(1)
    for _ in range(5000):
        data = bytearray(command if random.random() < 0.5 else random.bytes(random.integers(64)))
        if data:
            data[random.integers(len(data))] = random.integers(256)
        bank.hear(NODE, bytes(data))
        assert abs(bank.bank.torque_nm[0]) <= LIMIT_NM
        assert not (bank.bank.braked[0] and bank.bank.torque_nm[0])


@pytest.mark.parametrize("protocol", ["mit", "damiao", "cansimple", "cia402"])
def test_frames_for_others_move_nothing(protocol):
    bank = Bank(protocol)
    own = {0, 0x080, 0x700, NODE, *range(NODE << 5, (NODE << 5) + 32)}
    own |= {base + NODE for base in range(0x100, 0x800, 0x80)} | {0x100 + NODE, 0x7FF}
    for identifier in sorted(set(range(0x800)) - own):
        bank.assert_refused(identifier, b"\xff" * 8)

"""All drives of a robot together: cycles, faults of the environment, and a bus full of rubbish."""

import struct

import numpy as np
import pytest

from bus_schema.can.frame import BUS_OFF, BUS_RESTARTED, CanFrame
from bus_schema.can.mit.codec import MitCommand, MitRanges, packed_command, reply_of
from bus_schema.can.mit.protocol import MitSettings
from plant_emulator.drives.bank import DriveBank
from plant_emulator.drives.cansimple.drive import CanSimpleDrive
from plant_emulator.drives.cia402.drive import Cia402Drive
from plant_emulator.drives.damiao.drive import DamiaoDrive
from plant_emulator.drives.drive import DriveFault, DriveSettings
from plant_emulator.drives.mit.drive import MitDrive

NODES = (1, 2, 3)
MS = 1_000_000
PROTOCOLS = [Cia402Drive, CanSimpleDrive, MitDrive]
RANGES = MitRanges(4.0, 8.0, 60.0)
ENTER = b"\xff" * 7 + b"\xfc"


class Bank:
    def __init__(self, protocol):
        self.sent = []
        self.is_cia402, self.is_mit = protocol is Cia402Drive, protocol is MitDrive
        own = MitSettings(RANGES) if self.is_mit else None
        drives = [DriveSettings(node, 20.0, 60.0, watchdog_ms=50, own=own) for node in NODES]
        self.bank = DriveBank(protocol, drives, self.sent.append)
        self.bank.advance(0)

    def hear(self, identifier, form="", *values, remote=False, now_ns=0):
        data = struct.pack("<" + form, *values)
        self.bank.receive(CanFrame(identifier, data, is_remote=remote), now_ns)

    def enable(self):
        if self.is_mit:
            self.sample()
            for node in NODES:
                self.target(node, 0.0)
            self.bank.take_targets()
            self.sent.clear()
            return
        if self.is_cia402:
            self.hear(0, "BB", 1, 0)
        for node in NODES:
            if self.is_cia402:
                self.hear(0x300 + node, "b", 10)
                for word in (6, 7, 15):
                    self.hear(0x200 + node, "Hh", word, 0)
            else:
                self.hear(node << 5 | 0x0B, "II", 1, 1)
                self.hear(node << 5 | 0x07, "I", 8)
        self.bank.take_targets()
        self.sent.clear()

    def target(self, node, torque_nm, now_ns=0):
        if self.is_mit:
            command = packed_command(MitCommand(torque_nm=torque_nm), RANGES)
            self.bank.receive(CanFrame(node, command), now_ns)
        elif self.is_cia402:
            self.hear(0x200 + node, "Hh", 15, round(torque_nm / 0.02), now_ns=now_ns)
        else:
            self.hear(node << 5 | 0x0E, "f", torque_nm, now_ns=now_ns)

    def sample(self):
        if self.is_mit:
            for node in NODES:
                self.bank.receive(CanFrame(node, ENTER), 0)
        elif self.is_cia402:
            self.hear(0x80)
        else:
            for node in NODES:
                self.hear(node << 5 | 0x09, remote=True)


@pytest.fixture(params=PROTOCOLS)
def rig(request):
    made = Bank(request.param)
    made.enable()
    return made


def test_a_cycle_is_a_sampling_and_a_target_for_every_axis(rig):
    before = rig.bank.samplings
    rig.sample()
    assert rig.bank.samplings == before + 1
    assert len(rig.sent) == 3
    rig.target(1, 1.0)
    rig.target(2, 2.0)
    assert not rig.bank.take_targets()
    rig.target(3, -3.0)
    assert rig.bank.take_targets()
    assert not rig.bank.take_targets()
    # the coarsest protocol cuts off at 12 bits of ±60 N m
    np.testing.assert_allclose(rig.bank.torque_nm, [1.0, 2.0, -3.0], atol=0.03)
    assert not rig.bank.braked.any()


def test_a_silent_node_neither_hears_nor_is_heard_nor_awaited(rig):
    rig.bank.inject(1, DriveFault.SILENT, 0)
    rig.sample()
    assert len(rig.sent) == 2
    for node in NODES:
        rig.target(node, 5.0)
    assert rig.bank.take_targets()
    np.testing.assert_allclose(rig.bank.torque_nm, [5.0, 0.0, 5.0], atol=0.03)
    rig.bank.clear(1, DriveFault.SILENT, 0)
    rig.target(2, 5.0)
    assert rig.bank.torque_nm[1] == pytest.approx(5.0, abs=0.03)


def test_a_frozen_encoder_shows_its_last_value_and_no_velocity(rig):
    still = np.zeros(3)
    rig.bank.measure(np.array([0.1, 0.2, 0.3]), np.ones(3), still)
    rig.bank.inject(0, DriveFault.ENCODER_FROZEN, 0)
    rig.bank.measure(np.array([0.5, 0.5, 0.5]), np.ones(3), still)
    rig.sent.clear()
    rig.sample()
    if rig.is_mit:
        rows = [reply_of(frame.data, RANGES)[1:3] for frame in rig.sent]
    else:
        form = "<ii" if rig.is_cia402 else "<ff"
        turn = 1 << 20 if rig.is_cia402 else 1
        rows = [np.array(struct.unpack(form, frame.data)) * 2 * np.pi / turn for frame in rig.sent]
    off = 4e-3 if rig.is_mit else 1e-5
    np.testing.assert_allclose(rows, [[0.1, 0.0], [0.5, 1.0], [0.5, 1.0]], atol=off)
    rig.bank.clear(0, DriveFault.ENCODER_FROZEN, 0)
    rig.bank.measure(np.array([0.5, 0.5, 0.5]), np.ones(3), still)
    rig.sent.clear()
    rig.sample()
    own = slice(1, None) if rig.is_mit else slice(None)  # the first byte is the drive's address
    assert rig.sent[0].data[own] == rig.sent[1].data[own]


def test_a_fault_in_one_axis_leaves_the_others_to_the_master(rig):
    rig.bank.inject(2, DriveFault.DRIVE, 0)
    assert rig.bank.braked.tolist() == [False, False, True]
    assert len(rig.bank.faults) == 1
    assert rig.bank.faults[0].startswith("node 3: ")


def test_error_frame_reports_bus_off(rig):
    rig.bank.measure(np.zeros(3), np.ones(3), np.zeros(3))
    rig.bank.receive(CanFrame(BUS_OFF, is_error=True), 0)
    for tick in range(1, 400):
        rig.bank.advance(tick * MS)
    assert rig.bank.braked.all()
    assert not rig.sent
    rig.bank.receive(CanFrame(BUS_RESTARTED, is_error=True), 400 * MS)
    rig.bank.advance(600 * MS)
    rig.sample()
    assert rig.sent


@pytest.mark.parametrize(
    "frame",
    [
        CanFrame(0x201, bytes(64), is_fd=True),
        CanFrame(0x201, bytes(9)),
        CanFrame(0x201, b"\x0f\0\x64\0", is_extended=True),
        CanFrame(0x7FF, bytes(8)),
        CanFrame(0x20A, b"\x0f\0\x64\0"),
    ],
)
def test_frames_that_are_no_drives_business_are_counted(rig, frame):
    before = rig.bank.torque_nm.copy()
    rig.bank.receive(frame, 0)
    assert sum(rig.bank.rejections.counts.values()) == 1
    np.testing.assert_array_equal(rig.bank.torque_nm, before)


def test_frames_in_words():
    rig = Bank(Cia402Drive)
    for frame, words in (
        (CanFrame(0, bytes([1, 0])), "NMT START all nodes"),
        (CanFrame(0x80), "SYNC"),
        (CanFrame(0x202, b"\x0f\0\xfe\xff"), "node 2 RPDO Controlword 0x000F, Target torque -2"),
        (CanFrame(0x701, b"\x05"), "node 1 heartbeat OPERATIONAL"),
        (CanFrame(0x83, b"\x30\x81\x11\0\0\0\0\0"),
         "node 3 EMCY 0x8130 HEARTBEAT_LOST, register 17"),
        (CanFrame(0x601, b"\x2b\x5a\x60\0\x02\0\0\0"),
         "node 1 SDO download request 0x605A:00 Quick stop option code 0x2"),
        (CanFrame(0x581, b"\x80\x60\x60\0\x30\0\x09\x06"),
         "node 1 SDO abort 0x6060:00 Modes of operation 0x6090030"),
        (CanFrame(0x55, b""), "not for these drives"),
    ):  # fmt: skip
        assert rig.bank.describe(frame) == words
    axes = Bank(CanSimpleDrive)
    assert axes.bank.describe(CanFrame(2 << 5 | 0x0E, struct.pack("<f", 1.5))) == (
        "axis 2 Set_Input_Torque, Input_Torque 1.5"
    )
    assert axes.bank.describe(CanFrame(2 << 5 | 0x09, is_remote=True)) == (
        "axis 2 Get_Encoder_Estimates asked for"
    )


def test_frames_go_to_an_identifier_from_when_a_cia402_drive_is_given_it():
    bank = Bank(Cia402Drive)
    bank.enable()
    bank.hear(0x345, "Hh", 15, 100)
    assert bank.bank.rejections.counts == {"unknown_identifier": 1}
    bank.hear(0x602, "BHBI", 0x23, 0x1400, 1, 0x8000_0202)  # RPDO 1 of node 2 is not valid
    bank.hear(0x602, "BHBI", 0x23, 0x1400, 1, 0x345)
    bank.hear(0x345, "Hh", 15, 100)
    bank.hear(0x202, "Hh", 15, 50)
    assert bank.bank.torque_nm.tolist() == pytest.approx([0.0, 2.0, 0.0])
    assert bank.bank.rejections.counts == {"unknown_identifier": 2}


def test_frames_go_to_an_address_from_when_a_damiao_motor_is_given_it():
    bank = Bank(DamiaoDrive)
    bank.hear(9, "7sB", b"\xff" * 7, 0xFC)
    assert bank.bank.rejections.counts == {"unknown_identifier": 1}
    bank.hear(0x7FF, "HBBI", 2, 0x55, 8, 9)  # ESC_ID
    bank.hear(9, "7sB", b"\xff" * 7, 0xFC)
    bank.hear(2, "7sB", b"\xff" * 7, 0xFC)
    assert ["ENABLED" in each for each in bank.bank.statuses] == [False, True, False]
    assert bank.bank.rejections.counts == {"unknown_identifier": 2}

"""All drives of a robot together: cycles, faults, bus-off, invalid frames."""

import struct

import numpy as np
import pytest
from dialects import DIALECTS

from bus_schema.can.frame import BUS_OFF, BUS_RESTARTED, CanFrame
from plant_emulator.drives.bank import DriveBank
from plant_emulator.drives.drive import DriveFault

NODES = (1, 2, 3)
MS = 1_000_000


class Bank:
    """Three drives of a protocol, and their master."""

    def __init__(self, protocol):
        self.sent, self.protocol, self.dialect = [], protocol, DIALECTS[protocol]
        drives = [self.dialect.settings(node, watchdog_ms=50) for node in NODES]
        self.bank = DriveBank(self.dialect.drive, drives, self.sent.append)
        self.bank.advance(0)

    def hear(self, identifier, form="", *values):
        self.send(CanFrame(identifier, struct.pack("<" + form, *values)))

    def send(self, *frames):
        for frame in frames:
            self.bank.receive(frame, 0)

    def enable(self):
        for node in NODES:
            self.send(*self.dialect.start(node), self.dialect.torque(node, 0.0))
        self.bank.take_targets()
        self.sent.clear()

    def target(self, node, torque_nm):
        self.send(self.dialect.torque(node, torque_nm))

    def sample(self):
        """Request all states; return the answers."""
        self.sent.clear()
        self.send(*dict.fromkeys(self.dialect.request(node) for node in NODES))
        return self.sent


@pytest.fixture(params=DIALECTS)
def rig(request):
    made = Bank(request.param)
    made.enable()
    return made


def test_cycle_is_a_sampling_and_a_target_for_every_axis(rig):
    before = rig.bank.samplings
    assert len(rig.sample()) == 3
    assert rig.bank.samplings == before + 1
    rig.target(1, 1.0)
    rig.target(2, 2.0)
    assert not rig.bank.take_targets()
    rig.target(3, -3.0)
    assert rig.bank.take_targets()
    assert not rig.bank.take_targets()
    step = rig.dialect.torque_step
    np.testing.assert_allclose(rig.bank.torque_nm, [1.0, 2.0, -3.0], atol=step)
    assert not rig.bank.braked.any()


def test_silent_node_receives_and_sends_nothing_and_is_not_awaited(rig):
    rig.bank.inject(1, DriveFault.SILENT, 0)
    assert len(rig.sample()) == 2
    for node in NODES:
        rig.target(node, 5.0)
    assert rig.bank.take_targets()
    step = rig.dialect.torque_step
    np.testing.assert_allclose(rig.bank.torque_nm, [5.0, 0.0, 5.0], atol=step)
    rig.bank.clear(1, DriveFault.SILENT, 0)
    rig.target(2, 5.0)
    assert rig.bank.torque_nm[1] == pytest.approx(5.0, abs=step)


def test_frozen_encoder_reports_its_last_value_and_no_velocity(rig):
    def motions():
        rows = [rig.dialect.motion(answer) for answer in rig.sample()]
        return pytest.approx(np.array(rows), abs=rig.dialect.motion_step)

    still = np.zeros(3)
    rig.bank.measure(np.array([0.1, 0.2, 0.3]), np.ones(3), still)
    rig.bank.inject(0, DriveFault.ENCODER_FROZEN, 0)
    rig.bank.measure(np.array([0.5, 0.5, 0.5]), np.ones(3), still)
    assert motions() == np.array([[0.1, 0.0], [0.5, 1.0], [0.5, 1.0]])
    rig.bank.clear(0, DriveFault.ENCODER_FROZEN, 0)
    rig.bank.measure(np.array([0.5, 0.5, 0.5]), np.ones(3), still)
    assert motions() == np.array([[0.5, 1.0]] * 3)


def test_fault_in_one_axis_leaves_the_others_to_the_master(rig):
    rig.bank.inject(2, DriveFault.DRIVE, 0)
    assert rig.bank.braked.tolist() == [False, False, True]
    assert len(rig.bank.faults) == 1
    assert rig.bank.faults[0].startswith("node 3: ")


def test_bus_off_stops_drives_until_the_bus_is_back(rig):
    rig.bank.measure(np.zeros(3), np.ones(3), np.zeros(3))
    rig.bank.receive(CanFrame(BUS_OFF, is_error=True), 0)
    for tick in range(1, 400):
        rig.bank.advance(tick * MS)
    assert rig.bank.braked.all() == (rig.protocol != "moteus")  # which damps its joint
    assert not rig.sent
    rig.bank.receive(CanFrame(BUS_RESTARTED, is_error=True), 400 * MS)
    rig.bank.advance(600 * MS)
    assert rig.sent or rig.sample()  # an emergency, or an answer


@pytest.mark.parametrize(
    "frame",
    [
        CanFrame(0x201, bytes(64), is_fd=True),
        CanFrame(0x201, b"\xff" * 9),
        CanFrame(0x201, b"\x0f\0\x64\0", is_extended=True),
        CanFrame(0x7FF, bytes(8)),
        CanFrame(0x20A, b"\x0f\0\x64\0"),
    ],
)
def test_frames_for_no_drive_are_counted_and_change_nothing(rig, frame):
    before = rig.bank.torque_nm.copy()
    rig.bank.receive(frame, 0)
    assert sum(rig.bank.rejections.counts.values()) == 1
    np.testing.assert_array_equal(rig.bank.torque_nm, before)


def test_frames_go_to_an_identifier_from_when_a_cia402_drive_is_given_it():
    bank = Bank("cia402")
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
    bank = Bank("damiao")
    bank.hear(9, "7sB", b"\xff" * 7, 0xFC)
    assert bank.bank.rejections.counts == {"unknown_identifier": 1}
    bank.hear(0x7FF, "HBBI", 2, 0x55, 8, 9)  # ESC_ID
    bank.hear(9, "7sB", b"\xff" * 7, 0xFC)
    bank.hear(2, "7sB", b"\xff" * 7, 0xFC)
    assert ["ENABLED" in each for each in bank.bank.statuses] == [False, True, False]
    assert bank.bank.rejections.counts == {"unknown_identifier": 2}

"""All drives of a robot together: cycles, faults, bus-off, invalid frames."""

import struct

import numpy as np
import pytest
from dialects import DIALECTS
from drive_bench import Bank

from bus_schema.can.frame import BUS_OFF, BUS_RESTARTED, CanFrame
from plant_emulator.drives.drive import DriveFault

MS = 1_000_000


@pytest.fixture(params=DIALECTS)
def rig(request):
    made = Bank(request.param, watchdog_ms=50)
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
    for node in rig.nodes:
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
    assert not rig.take()
    rig.bank.receive(CanFrame(BUS_RESTARTED, is_error=True), 400 * MS)
    rig.bank.advance(600 * MS)
    assert rig.take() or rig.sample()  # an emergency, or an answer


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
    rig.assert_refused(frame)
    np.testing.assert_array_equal(rig.bank.torque_nm, before)


def sdo(node, index, value):
    return CanFrame(0x600 + node, struct.pack("<BHBI", 0x23, index, 1, value))


ENABLE_MOTOR = b"\xff" * 7 + b"\xfc"
ESC_ID_OF_2_IS_9 = CanFrame(0x7FF, struct.pack("<HBBI", 2, 0x55, 8, 9))
MOVED = {
    "cia402": (0x345, 0x202, struct.pack("<Hh", 15, 100),
               [sdo(2, 0x1400, 0x8000_0202), sdo(2, 0x1400, 0x345)]),  # RPDO 1 of node 2
    "damiao": (9, 2, ENABLE_MOTOR, [ESC_ID_OF_2_IS_9]),
}  # fmt: skip


@pytest.mark.parametrize("protocol", MOVED)
def test_frames_follow_a_drive_to_another_identifier(protocol):
    new, old, data, move = MOVED[protocol]
    bank = Bank(protocol)
    if protocol == "cia402":
        bank.enable()
    bank.assert_refused(CanFrame(new, data))
    bank.send(*move, CanFrame(new, data))
    reached = bank.bank.torque_nm.tolist(), bank.bank.statuses
    bank.assert_refused(CanFrame(old, data))
    assert bank.bank.rejections.counts == {"unknown_identifier": 2}
    if protocol == "cia402":
        assert reached[0] == pytest.approx([0.0, 2.0, 0.0])
    else:
        assert ["ENABLED" in each for each in reached[1]] == [False, True, False]

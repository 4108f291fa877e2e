"""The CANSimple axis against ODrive's public protocol description: identifier = node << 5 |
command, little endian, IEEE 754 floats."""

import math
import struct
from dataclasses import replace

import pytest
from drive_bench import MS, NODE, SETTINGS, Bench

from bus_schema.can.frame import CanFrame
from bus_schema.errors import InvalidMessageError
from bus_schema.link.can_configuration import CanConfiguration, CanSimpleConfiguration
from plant_emulator.configuration import PlantConfiguration
from plant_emulator.drives.cansimple.drive import CanSimpleDrive
from plant_emulator.drives.commissioning import build_bank
from plant_emulator.drives.drive import AT_REST, DriveFault
from tests.arms import PAPER_ARM

HEARTBEAT, ESTOP, GET_ERROR, SET_STATE, ESTIMATES, SET_MODE, SET_TORQUE, LIMITS = (
    0x01, 0x02, 0x03, 0x07, 0x09, 0x0B, 0x0E, 0x0F,
)  # fmt: skip
GET_IQ, TEMPERATURE, REBOOT, BUS, TORQUES, POWERS = 0x14, 0x15, 0x16, 0x17, 0x1C, 0x1D
IDLE, CLOSED_LOOP, CALIBRATION = 1, 8, 3
BAD_CONFIG, TOO_FAST = 0x10, 0x8000


class Axis(Bench):
    def __init__(self, **changes):
        super().__init__(
            CanSimpleDrive,
            replace(SETTINGS, own=CanSimpleConfiguration(), **changes),
        )

    def send(self, command, form="", *values):
        return self.hear(NODE << 5 | command, *struct.pack("<" + form, *values))

    def ask(self, command, form):
        self.take()
        self.hear(NODE << 5 | command, remote=True)
        (data,) = self.take(NODE << 5 | command)
        return struct.unpack("<" + form, data)

    def arm(self):
        self.send(SET_MODE, "II", 1, 1)
        self.send(SET_STATE, "I", CLOSED_LOOP)

    @property
    def heartbeat(self):
        """Axis error, axis state, procedure result, trajectory done."""
        return self.ask(HEARTBEAT, "IBBBx")


@pytest.fixture
def axis():
    made = Axis()
    made.arm()
    made.take()
    return made


def test_cyclic_messages(axis):
    axis.take()
    axis.wait(1000)
    frames = axis.take()
    assert sum(frame.identifier == NODE << 5 | HEARTBEAT for frame in frames) == 10
    assert sum(frame.identifier == NODE << 5 | ESTIMATES for frame in frames) == 100


def test_estimates_are_turns_in_whole_increments(axis):
    axis.move(position_rad=math.pi / 2, velocity_rad_s=-math.pi)
    assert axis.ask(ESTIMATES, "ff") == (0.25, -0.5)
    axis.move(position_rad=2 * math.pi * 0.7 / SETTINGS.counts_per_turn)
    assert axis.ask(ESTIMATES, "ff")[0] == 1 / SETTINGS.counts_per_turn
    assert axis.drive.samplings == 2


def test_axis_answers_all_other_requests(axis):
    axis.send(SET_TORQUE, "f", 12.0)
    axis.move(velocity_rad_s=2.0, torque_nm=11.0)
    assert axis.ask(TORQUES, "ff") == (12.0, 11.0)
    assert axis.ask(GET_IQ, "ff") == (12.0, 11.0)  # 1 N m/A
    assert axis.ask(POWERS, "ff") == (22.0, 22.0)
    assert axis.ask(BUS, "ff") == pytest.approx((48.0, 22.0 / 48.0))
    assert axis.ask(TEMPERATURE, "ff") == (25.0, 25.0)
    assert axis.ask(GET_ERROR, "II") == (0, 0)
    assert axis.ask(0x00, "8B")[0] == 2  # protocol version
    assert axis.ask(0x06, "B6sB") == (NODE, bytes([NODE, 0, 0, 0, 0, 0]), 0)


OTHERS = {
    "RxSdo": (0x04, "BHBI", 1, 2, 0, 3), "Set_Traj_Vel_Limit": (0x11, "f", 1.0),
    "Set_Traj_Accel_Limits": (0x12, "ff", 1.0, 2.0), "Set_Traj_Inertia": (0x13, "f", 1.0),
    "Enter_DFU_Mode": (0x1F, ""),
}  # fmt: skip


@pytest.mark.parametrize("name", OTHERS)
def test_messages_of_missing_functions_are_refused_by_name(axis, name):
    axis.send(SET_TORQUE, "f", 2.0)
    with pytest.raises(InvalidMessageError, match=name) as refusal:
        axis.send(*OTHERS[name])
    assert refusal.value.reason == "not_there"
    assert axis.drive.demand()[:2] == (2.0, True)


@pytest.mark.parametrize("mode", [(0, 1), (4, 1), (1, 6), (2, 2), (3, 3), (3, 5)])
def test_missing_modes_are_bad_configuration(mode):
    axis = Axis()
    axis.send(SET_MODE, "II", *mode)
    axis.send(SET_STATE, "I", CLOSED_LOOP)
    assert axis.heartbeat[:2] == (BAD_CONFIG, IDLE)


def test_missing_states_are_refused(axis):
    axis.send(SET_STATE, "I", CALIBRATION)
    assert axis.heartbeat == (0, CLOSED_LOOP, 13, 0)  # INVALID_STATE


def test_limits_of_torque_and_speed(axis):
    axis.send(SET_TORQUE, "f", 1e6)
    assert axis.drive.demand().torque_nm == 60.0
    axis.send(LIMITS, "ff", 1.0, 30.0)
    assert axis.drive.demand().torque_nm == 30.0
    axis.send(LIMITS, "ff", 1.0, 1e6)
    assert axis.drive.demand().torque_nm == 60.0  # the motor's limit
    axis.move(velocity_rad_s=1.19 * 2 * math.pi)
    assert axis.drive.demand().is_released
    axis.move(velocity_rad_s=1.21 * 2 * math.pi)
    assert axis.drive.demand() == AT_REST
    assert axis.heartbeat[0] == TOO_FAST


@pytest.mark.parametrize(
    ("fault", "error"),
    [
        (DriveFault.DRIVE, 0x20), (DriveFault.OVER_TEMPERATURE, 0x2000), (DriveFault.ENCODER, 0x8)
    ],
)  # fmt: skip
def test_fault_disarms_and_outlasts_a_reboot_while_its_cause_remains(axis, fault, error):
    axis.drive.inject(fault, 0)
    assert axis.ask(GET_ERROR, "II") == (error, error)
    axis.send(SET_STATE, "I", CLOSED_LOOP)
    assert axis.heartbeat == (error, IDLE, 3, 0)  # DISARMED
    axis.send(REBOOT, "B", 0)
    assert (axis.heartbeat[0] == 0) == (fault is DriveFault.DRIVE)


def test_reboot_forgets_everything(axis):
    axis.send(ESTOP)
    axis.send(REBOOT, "B", 0)
    assert axis.heartbeat == (0, IDLE, 0, 0)
    axis.move(position_rad=0.3)
    axis.send(SET_TORQUE, "f", 5.0)
    axis.send(SET_STATE, "I", CLOSED_LOOP)
    assert axis.heartbeat[0] == 0
    target_rad = axis.drive.demand().loop.target_rad
    assert target_rad == pytest.approx(0.3, abs=1e-5)  # a fresh one: position


@pytest.mark.parametrize(
    ("given", "polled", "watchdog_bites"),
    [({}, False, False), ({"command_timeout_ms": 50}, False, True), ({}, True, True)],
)
def test_no_watchdog_as_delivered(given, polled, watchdog_bites):
    """An axis that is alone with its client waits for ever; in the closed loop it does not."""
    can = CanConfiguration(protocol="cansimple", **given)
    bank = build_bank(can, PAPER_ARM, PlantConfiguration(), lambda _: None, polled=polled)
    for command, data in ((SET_MODE, struct.pack("<II", 1, 1)), (SET_STATE, b"\x08\0\0\0")):
        bank.receive(CanFrame(1 << 5 | command, data), 0)
    assert not bank.braked[0]
    bank.advance(3600 * 1000 * MS)
    assert bank.braked[0] == watchdog_bites

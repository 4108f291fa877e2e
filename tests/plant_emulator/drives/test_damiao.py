"""A Damiao motor alone, with frames packed by public descriptions."""

from __future__ import annotations

import math
import struct

import pytest
from dialects import CLEAR, DISABLE, DM4310, ENABLE, command, unpacked
from drive_bench import MS, NODE, Bench

from bus_schema.can.damiao.codec import DamiaoMode, Target, target_of
from bus_schema.can.damiao.motors import MOTORS
from bus_schema.can.damiao.protocol import DamiaoSettings
from bus_schema.can.frame import CanFrame
from bus_schema.errors import InvalidMessageError
from plant_emulator.drives.cascade import CascadeGains
from plant_emulator.drives.damiao.drive import DamiaoDrive
from plant_emulator.drives.drive import AT_REST, DriveFault, DriveSettings

FEEDBACK = 0x15
REFRESH, READ, WRITE, STORE = 0xCC, 0x33, 0x55, 0xAA
UV_VALUE, MAX_SPD, MST_ID, ESC_ID, TIMEOUT, CTRL_MODE = 0, 6, 7, 8, 9, 10
VMAX, TMAX, XOUT = 22, 23, 81
GAINS = CascadeGains(10.0, 2.0, 0.0)


class Motor(Bench):
    """One motor and what it sent."""

    def __init__(self, *, watchdog_ms=0, motor="DM4310", fd=False, effort_nm=100.0):
        settings = DriveSettings(
            NODE, effort_nm, watchdog_ms=watchdog_ms, fd_process_data=fd, gains=GAINS,
            own=DamiaoSettings(MOTORS[motor], FEEDBACK),
        )  # fmt: skip
        super().__init__(DamiaoDrive, settings)

    def state(self, data, identifier=NODE):
        """Send a frame; error, node and temperatures in the answer, and position."""
        answer = self.answer(data, identifier)
        assert answer.identifier == FEEDBACK
        first, *_, mosfet_c, rotor_c = answer.data
        _, position, _, _ = unpacked(answer.data, DM4310)
        return first >> 4, first & 0xF, mosfet_c, rotor_c, pytest.approx(position, abs=4e-4)

    def ask(self, request, register=0, value=bytes(4)):
        """Send a frame to identifier 0x7FF; the answer's data."""
        return self.answer(struct.pack("<HBB", NODE, request, register) + value, 0x7FF).data

    def enable(self, mode=None):
        if mode is not None:
            self.ask(WRITE, CTRL_MODE, struct.pack("<I", mode))
        self.answer(ENABLE)


def test_states_are_in_the_high_half_of_the_first_byte_and_temperatures_in_the_last_two():
    motor = Motor()
    motor.move(1.25)
    assert motor.state(DISABLE) == (0, NODE, 25, 25, 1.25)
    assert motor.state(ENABLE) == (1, NODE, 25, 25, 1.25)
    motor.drive.inject(DriveFault.OVER_TEMPERATURE, 0)
    assert motor.state(ENABLE) == (0xC, NODE, 110, 110, 1.25)
    assert motor.state(CLEAR) == (0xC, NODE, 110, 110, 1.25)  # still hot


SLOW_TO_1 = struct.pack("<ff", 1.0, 0.5)
BACKWARDS = struct.pack("<f", -2.0)
A_QUARTER_OF_7_NM = struct.pack("<fHH", 1.0, 300, 2500)


@pytest.mark.parametrize(
    ("mode", "data", "position", "velocity", "torque_nm"),
    [
        (DamiaoMode.POS_VEL, SLOW_TO_1, 0.0, 0.0, 2.0 * 0.5),
        (DamiaoMode.POS_VEL, SLOW_TO_1, 0.98, 0.0, 0.4),
        (DamiaoMode.POS_VEL, struct.pack("<ff", 1e6, 1e6), 0.0, 0.0, 7.0),
        (DamiaoMode.VEL, BACKWARDS, 5.0, -2.0, 0.0), (DamiaoMode.VEL, BACKWARDS, 5.0, -1.0, -2.0),
        (DamiaoMode.VEL, BACKWARDS + bytes(4), 5.0, -1.0, -2.0),  # padded
        (DamiaoMode.POS_FORCE, A_QUARTER_OF_7_NM, 0.9, 0.0, 1.75),
        (DamiaoMode.POS_FORCE, A_QUARTER_OF_7_NM, 0.95, 0.0, 1.0),
    ],
)  # fmt: skip
def test_loop_of_each_mode_has_its_limits(mode, data, position, velocity, torque_nm):
    motor = Motor()
    motor.enable(mode)
    motor.answer(data, NODE + mode.offset)
    loop = motor.drive.demand().loop
    assert loop.torque_nm(position, velocity) == pytest.approx(torque_nm, abs=1e-3)


def test_targets_are_read_as_openarm_can_packs_them():
    speed_and_share = struct.pack("<fHH", 0.5, 150, 2500)  # rad/s / 100, and 1/10,000
    assert target_of(DamiaoMode.POS_VEL, struct.pack("<ff", 0.5, 1.5)) == Target(0.5, 1.5)
    assert target_of(DamiaoMode.VEL, struct.pack("<f", 1.5)) == Target(0.0, 1.5)
    assert target_of(DamiaoMode.POS_FORCE, speed_and_share) == Target(0.5, 1.5, 0.25)


@pytest.mark.parametrize("mode", list(DamiaoMode))
def test_commands_of_another_mode_are_refused_without_an_answer(mode):
    motor = Motor()
    motor.enable(mode)
    frames = {
        DamiaoMode.MIT: command(t=1.0, ranges=DM4310),
        DamiaoMode.POS_VEL: struct.pack("<ff", 1.0, 1.0), DamiaoMode.VEL: struct.pack("<f", 1.0),
        DamiaoMode.POS_FORCE: struct.pack("<fHH", 1.0, 100, 100),
    }  # fmt: skip
    for other, data in frames.items():
        if other is not mode:
            motor.sent.clear()
            with pytest.raises(InvalidMessageError, match="CTRL_MODE is") as refused:
                motor.drive.receive(CanFrame(NODE + other.offset, data), 0)
            assert refused.value.reason == "wrong_mode"
            assert motor.sent == []
    assert motor.drive.demand() == AT_REST
    motor.answer(frames[mode], NODE + mode.offset)
    assert motor.drive.demand().is_released
    assert motor.drive.status == f"ENABLED ({mode.name})"


def test_a_new_mode_waits_for_its_first_command():
    motor = Motor()
    motor.answer(ENABLE)
    motor.answer(command(t=1.0, ranges=DM4310))
    assert motor.ask(WRITE, CTRL_MODE, struct.pack("<I", 3))[2:4] == bytes([WRITE, CTRL_MODE])
    assert motor.drive.demand() == AT_REST
    motor.answer(ENABLE, NODE + 0x200)  # special frames go to the address of the mode, too


def test_registers_are_read_and_written_as_numbers_of_their_kind():
    motor = Motor()
    assert motor.ask(READ, MST_ID) == bytes([NODE, 0, READ, MST_ID]) + struct.pack("<I", FEEDBACK)
    assert struct.unpack("<f", motor.ask(READ, VMAX)[4:])[0] == 30.0
    assert struct.unpack("<f", motor.ask(READ, MAX_SPD)[4:])[0] == pytest.approx(20.94)
    eighteen = struct.pack("<f", 18.0)
    assert motor.ask(WRITE, UV_VALUE, eighteen) == bytes([NODE, 0, WRITE, UV_VALUE]) + eighteen
    assert motor.ask(READ, UV_VALUE)[4:] == eighteen
    motor.move(0.75)
    assert struct.unpack("<f", motor.ask(READ, XOUT)[4:])[0] == pytest.approx(0.75, abs=1e-5)


@pytest.mark.parametrize(
    ("request_", "register", "value", "reason"),
    [
        (READ, 99, bytes(4), "no_register"),
        (WRITE, 99, bytes(4), "no_value"),
        (WRITE, XOUT, bytes(4), "no_value"),
        (WRITE, CTRL_MODE, struct.pack("<I", 5), "no_value"),
        (WRITE, TMAX, struct.pack("<f", 0.0), "no_value"),
        (WRITE, TMAX, struct.pack("<f", math.nan), "no_value"),
        (0x42, 0, bytes(4), "no_request"),
    ],
)
def test_other_requests_are_refused_without_an_answer(request_, register, value, reason):
    motor = Motor()
    data = struct.pack("<HBB", NODE, request_, register) + value
    with pytest.raises(InvalidMessageError) as refused:
        motor.drive.receive(CanFrame(0x7FF, data), 0)
    assert (refused.value.reason, motor.sent) == (reason, [])


def test_registers_are_stored_in_the_disabled_state_only():
    motor = Motor()
    assert motor.ask(STORE, 1) == bytes([NODE, 0, STORE, 1, 0, 0, 0, 0])
    motor.answer(ENABLE)
    with pytest.raises(InvalidMessageError, match="does nothing"):
        motor.ask(STORE)


def test_identifiers_and_ranges_change_at_once():
    """As the identifiers do for `openarm-can-cli change_motor_id`."""
    motor = Motor()
    motor.ask(WRITE, ESC_ID, struct.pack("<I", 9))
    assert not motor.drive.receive(CanFrame(NODE, ENABLE), 0)
    data = struct.pack("<HBBI", 9, WRITE, MST_ID, 0x19)
    assert motor.answer(data, 0x7FF).identifier == 0x19
    motor.move(0.0, 3.0)
    motor.answer(struct.pack("<HBBf", 9, WRITE, VMAX, 5.0), 0x7FF)
    answer = motor.answer(ENABLE, 9)
    assert unpacked(answer.data, (12.5, 5.0, 500.0, 5.0, 10.0))[2] == pytest.approx(3.0, abs=3e-3)


def test_timeout_register_is_in_steps_of_50_us_and_its_error_waits_to_be_cleared():
    motor = Motor(watchdog_ms=50)
    assert struct.unpack("<I", motor.ask(READ, TIMEOUT)[4:])[0] == 1000
    motor.answer(ENABLE)
    motor.now_ns = 100 * MS
    motor.answer(command(t=1.0, ranges=DM4310))
    motor.drive.advance(151 * MS)
    assert motor.state(ENABLE)[0] == 0xD
    motor.answer(CLEAR)
    assert motor.state(ENABLE)[0] == 1
    motor.ask(WRITE, TIMEOUT, struct.pack("<I", 0))
    motor.answer(command(t=1.0, ranges=DM4310))
    motor.drive.advance(10_000 * MS)
    assert motor.drive.demand().is_released


def test_motor_of_can_fd_answers_in_fd_frames():
    motor = Motor(fd=True)
    assert motor.answer(ENABLE).is_fd
    assert motor.ask(READ, 35)[4] == 9  # CAN_BR: 5 Mbit/s


@pytest.mark.parametrize(
    ("motor", "peak_nm"), [("DM4310", 7.0), ("DM4340", 27.0), ("DM8009", 40.0)]
)
def test_torque_is_limited_by_the_motor_and_by_the_joint(motor, peak_nm):
    ranges = MOTORS[motor].ranges
    book = (*ranges[:2], *ranges[3:], ranges[2])
    for effort_nm in (100.0, 2.0):
        limited = Motor(motor=motor, effort_nm=effort_nm)
        limited.enable()
        limited.answer(command(t=-ranges.torque_nm, ranges=book))
        assert limited.drive.demand().torque_nm == -min(peak_nm, effort_nm)

"""A Damiao motor alone, with frames packed by public descriptions."""

from __future__ import annotations

import math
import struct

import pytest
from dialects import CLEAR, DISABLE, DM4310, ENABLE, command, unpacked

from bus_schema.can.damiao.codec import DamiaoMode, Target, packed_target, target_of
from bus_schema.can.damiao.motors import MOTORS
from bus_schema.can.damiao.protocol import DamiaoSettings
from bus_schema.can.frame import CanFrame
from bus_schema.errors import InvalidMessageError
from plant_emulator.drives.cascade import CascadeGains
from plant_emulator.drives.damiao.drive import DamiaoDrive
from plant_emulator.drives.drive import AT_REST, DriveFault, DriveSettings, JointReading

MS = 1_000_000
NODE, FEEDBACK = 5, 0x15
REFRESH, READ, WRITE, STORE = 0xCC, 0x33, 0x55, 0xAA
UV_VALUE, MAX_SPD, MST_ID, ESC_ID, TIMEOUT, CTRL_MODE = 0, 6, 7, 8, 9, 10
VMAX, TMAX, XOUT = 22, 23, 81
GAINS = CascadeGains(10.0, 2.0, 0.0)


class Bench:
    """One motor and what it sent."""

    def __init__(self, *, watchdog_ms=0, motor="DM4310", fd=False, effort_nm=100.0):
        self.sent = []
        settings = DriveSettings(
            NODE, effort_nm, watchdog_ms=watchdog_ms, fd_process_data=fd, gains=GAINS,
            own=DamiaoSettings(MOTORS[motor], FEEDBACK),
        )  # fmt: skip
        self.drive = DamiaoDrive(settings, self.sent.append)

    def hear(self, data, identifier=NODE, now_ns=0):
        """Send a frame; the answer."""
        self.sent.clear()
        assert self.drive.receive(CanFrame(identifier, data), now_ns)
        (answer,) = self.sent
        return answer

    def state(self, data, identifier=NODE):
        """Send a frame; error, node and temperatures in the answer, and position."""
        answer = self.hear(data, identifier)
        assert answer.identifier == FEEDBACK
        first, *_, mosfet_c, rotor_c = answer.data
        _, position, _, _ = unpacked(answer.data, DM4310)
        return first >> 4, first & 0xF, mosfet_c, rotor_c, pytest.approx(position, abs=4e-4)

    def ask(self, request, register=0, value=bytes(4)):
        """Send a frame to identifier 0x7FF; the answer's data."""
        data = struct.pack("<HBB", NODE, request, register) + value
        return self.hear(data, 0x7FF).data

    def at(self, position, velocity=0.0, torque=0.0):
        self.drive.measure(JointReading(position, velocity, torque))

    def in_mode(self, mode):
        self.ask(WRITE, CTRL_MODE, struct.pack("<I", mode))
        self.hear(ENABLE)


def test_states_are_in_the_high_half_of_the_first_byte_and_temperatures_in_the_last_two():
    bench = Bench()
    bench.at(1.25)
    assert bench.state(DISABLE) == (0, NODE, 25, 25, 1.25)
    assert bench.state(ENABLE) == (1, NODE, 25, 25, 1.25)
    bench.drive.inject(DriveFault.OVER_TEMPERATURE, 0)
    assert bench.state(ENABLE) == (0xC, NODE, 110, 110, 1.25)
    assert bench.state(CLEAR) == (0xC, NODE, 110, 110, 1.25)  # still hot


def test_position_velocity_goes_to_a_position_no_faster_than_it_may():
    bench = Bench()
    bench.in_mode(DamiaoMode.POS_VEL)
    bench.hear(struct.pack("<ff", 1.0, 0.5), NODE + 0x100)
    loop = bench.drive.demand().loop
    assert loop.torque_nm(0.0, 0.0) == pytest.approx(2.0 * 0.5)
    assert loop.torque_nm(0.98, 0.0) == pytest.approx(2.0 * 10.0 * 0.02, abs=1e-3)
    bench.hear(struct.pack("<ff", 1e6, 1e6), NODE + 0x100)
    assert bench.drive.demand().torque_nm == 7.0


@pytest.mark.parametrize("padding", [b"", bytes(4)])  # openarm_can sends four bytes
def test_velocity_mode_turns_at_a_speed(padding):
    bench = Bench()
    bench.in_mode(DamiaoMode.VEL)
    bench.hear(struct.pack("<f", -2.0) + padding, NODE + 0x200)
    loop = bench.drive.demand().loop
    assert loop.torque_nm(5.0, -2.0) == pytest.approx(0.0)
    assert loop.torque_nm(5.0, -1.0) == pytest.approx(-2.0)


def test_position_force_limits_speed_and_torque():
    bench = Bench()
    bench.in_mode(DamiaoMode.POS_FORCE)
    bench.hear(struct.pack("<fHH", 1.0, 300, 2500), NODE + 0x300)
    loop = bench.drive.demand().loop
    assert loop.torque_nm(0.9, 0.0) == pytest.approx(1.75)  # a quarter of 7 N m
    assert loop.torque_nm(0.95, 0.0) == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize("mode", [DamiaoMode.POS_VEL, DamiaoMode.VEL, DamiaoMode.POS_FORCE])
def test_targets_survive_packing(mode):
    target = Target(
        0.0 if mode is DamiaoMode.VEL else 0.5, 1.5, 0.25 if mode is DamiaoMode.POS_FORCE else 1.0
    )
    assert target_of(mode, packed_target(mode, target)) == target


@pytest.mark.parametrize("mode", list(DamiaoMode))
def test_commands_of_another_mode_are_refused_without_an_answer(mode):
    bench = Bench()
    bench.in_mode(mode)
    frames = {
        DamiaoMode.MIT: command(t=1.0, ranges=DM4310),
        DamiaoMode.POS_VEL: struct.pack("<ff", 1.0, 1.0), DamiaoMode.VEL: struct.pack("<f", 1.0),
        DamiaoMode.POS_FORCE: struct.pack("<fHH", 1.0, 100, 100),
    }  # fmt: skip
    for other, data in frames.items():
        if other is not mode:
            bench.sent.clear()
            with pytest.raises(InvalidMessageError, match="CTRL_MODE is") as refused:
                bench.drive.receive(CanFrame(NODE + other.offset, data), 0)
            assert refused.value.reason == "wrong_mode"
            assert bench.sent == []
    assert bench.drive.demand() == AT_REST
    bench.hear(frames[mode], NODE + mode.offset)
    assert bench.drive.demand().is_released
    assert bench.drive.status == f"ENABLED ({mode.name})"


def test_a_new_mode_waits_for_its_first_command():
    bench = Bench()
    bench.hear(ENABLE)
    bench.hear(command(t=1.0, ranges=DM4310))
    assert bench.ask(WRITE, CTRL_MODE, struct.pack("<I", 3))[2:4] == bytes([WRITE, CTRL_MODE])
    assert bench.drive.demand() == AT_REST
    bench.hear(ENABLE, NODE + 0x200)  # special frames go to the address of the mode, too


def test_registers_are_read_and_written_as_numbers_of_their_kind():
    bench = Bench()
    assert bench.ask(READ, MST_ID) == bytes([NODE, 0, READ, MST_ID]) + struct.pack("<I", FEEDBACK)
    assert struct.unpack("<f", bench.ask(READ, VMAX)[4:])[0] == 30.0
    assert struct.unpack("<f", bench.ask(READ, MAX_SPD)[4:])[0] == pytest.approx(20.94)
    eighteen = struct.pack("<f", 18.0)
    assert bench.ask(WRITE, UV_VALUE, eighteen) == bytes([NODE, 0, WRITE, UV_VALUE]) + eighteen
    assert bench.ask(READ, UV_VALUE)[4:] == eighteen
    bench.at(0.75)
    assert struct.unpack("<f", bench.ask(READ, XOUT)[4:])[0] == pytest.approx(0.75, abs=1e-5)


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
    bench = Bench()
    data = struct.pack("<HBB", NODE, request_, register) + value
    with pytest.raises(InvalidMessageError) as refused:
        bench.drive.receive(CanFrame(0x7FF, data), 0)
    assert (refused.value.reason, bench.sent) == (reason, [])


def test_registers_are_stored_in_the_disabled_state_only():
    bench = Bench()
    assert bench.ask(STORE, 1) == bytes([NODE, 0, STORE, 1, 0, 0, 0, 0])
    bench.hear(ENABLE)
    with pytest.raises(InvalidMessageError, match="does nothing"):
        bench.ask(STORE)


def test_identifiers_and_ranges_change_at_once():
    """As the identifiers do for `openarm-can-cli change_motor_id`."""
    bench = Bench()
    bench.ask(WRITE, ESC_ID, struct.pack("<I", 9))
    assert not bench.drive.receive(CanFrame(NODE, ENABLE), 0)
    data = struct.pack("<HBBI", 9, WRITE, MST_ID, 0x19)
    assert bench.hear(data, 0x7FF).identifier == 0x19
    bench.at(0.0, 3.0)
    bench.hear(struct.pack("<HBBf", 9, WRITE, VMAX, 5.0), 0x7FF)
    answer = bench.hear(ENABLE, 9)
    assert unpacked(answer.data, (12.5, 5.0, 500.0, 5.0, 10.0))[2] == pytest.approx(3.0, abs=3e-3)


def test_timeout_register_is_in_steps_of_50_us_and_its_error_waits_to_be_cleared():
    bench = Bench(watchdog_ms=50)
    assert struct.unpack("<I", bench.ask(READ, TIMEOUT)[4:])[0] == 1000
    bench.hear(ENABLE)
    bench.hear(command(t=1.0, ranges=DM4310), now_ns=100 * MS)
    bench.drive.advance(151 * MS)
    assert bench.state(ENABLE)[0] == 0xD
    bench.hear(CLEAR)
    assert bench.state(ENABLE)[0] == 1
    bench.ask(WRITE, TIMEOUT, struct.pack("<I", 0))
    bench.hear(command(t=1.0, ranges=DM4310))
    bench.drive.advance(10_000 * MS)
    assert bench.drive.demand().is_released


def test_motor_of_can_fd_answers_in_fd_frames():
    bench = Bench(fd=True)
    assert bench.hear(ENABLE).is_fd
    assert bench.ask(READ, 35)[4] == 9  # CAN_BR: 5 Mbit/s


@pytest.mark.parametrize(
    ("motor", "peak_nm"), [("DM4310", 7.0), ("DM4340", 27.0), ("DM8009", 40.0)]
)
def test_torque_is_limited_by_the_motor_and_by_the_joint(motor, peak_nm):
    ranges = MOTORS[motor].ranges
    book = (*ranges[:2], *ranges[3:], ranges[2])
    for effort_nm in (100.0, 2.0):
        bench = Bench(motor=motor, effort_nm=effort_nm)
        bench.hear(ENABLE)
        bench.hear(command(t=-ranges.torque_nm, ranges=book))
        assert bench.drive.demand().torque_nm == -min(peak_nm, effort_nm)

"""The MIT protocol: a drive alone, and a client that packs frames by the public description."""

import can
import numpy as np
import pytest

from bus_schema.can.frame import CanFrame
from bus_schema.can.mit.codec import MitRanges
from bus_schema.can.mit.protocol import MitSettings
from bus_schema.errors import InvalidMessageError
from plant_emulator.drives.drive import AT_REST, DriveFault, DriveSettings, JointReading
from plant_emulator.drives.mit.drive import MitDrive
from tests.plant_emulator.drives.test_clients import (
    JOINT,
    NODE_ID,
    PATIENCE_S,
    PUSH_NM,
    START,
    Rig,
    assert_energy_agrees,
    until,
)

MS = 1_000_000
NODE = 5
AK80_9 = (12.5, 50.0, 500.0, 5.0, 18.0)
P_MAX, V_MAX, _, _, T_MAX = AK80_9
ENTER, EXIT, ZERO = (bytes([255] * 7 + [last]) for last in (0xFC, 0xFD, 0xFE))


def to_uint(value, low, high, bits):
    """float_to_uint of the mini-cheetah's motor controller."""
    return int((value - low) * ((1 << bits) - 1) / (high - low))


def to_float(bits, low, high, length):
    return bits * (high - low) / ((1 << length) - 1) + low


def command(p=0.0, v=0.0, kp=0.0, kd=0.0, t=0.0, *, ranges=AK80_9):
    """pack_cmd, bit by bit as the description draws the eight bytes."""
    p_max, v_max, kp_max, kd_max, t_max = ranges
    p, v = to_uint(p, -p_max, p_max, 16), to_uint(v, -v_max, v_max, 12)
    kp, kd = to_uint(kp, 0.0, kp_max, 12), to_uint(kd, 0.0, kd_max, 12)
    t = to_uint(t, -t_max, t_max, 12)
    return bytes([
        p >> 8, p & 0xFF, v >> 4, (v & 0xF) << 4 | kp >> 8, kp & 0xFF, kd >> 4,
        (kd & 0xF) << 4 | t >> 8, t & 0xFF,
    ])  # fmt: skip


def unpacked(data, ranges=AK80_9):
    """unpack_reply: id, position, velocity, torque."""
    p_max, v_max, _, _, t_max = ranges
    return (
        data[0],
        to_float(data[1] << 8 | data[2], -p_max, p_max, 16),
        to_float(data[3] << 4 | data[4] >> 4, -v_max, v_max, 12),
        to_float((data[4] & 0xF) << 8 | data[5], -t_max, t_max, 12),
    )


class Bench:
    """One drive and what it sent."""

    def __init__(self, *, watchdog_ms=0, **own):
        self.sent = []
        settings = DriveSettings(NODE, 1.0, 15.0, watchdog_ms=watchdog_ms, own=MitSettings(**own))
        self.drive = MitDrive(settings, self.sent.append)

    def say(self, data, now_ns=0):
        """Send a frame; its reply."""
        assert self.drive.receive(CanFrame(NODE, data), now_ns)
        return self.sent[-1]

    def at(self, position, velocity=0.0, torque=0.0):
        self.drive.measure(JointReading(position, velocity, torque))


def test_every_frame_is_replied_to_with_the_state_and_resolution_is_real():
    bench = Bench()
    bench.at(1.2345, -3.21, 4.5)
    for data in (ENTER, command(), EXIT, command()):
        reply = bench.say(data)
        assert reply.identifier == 0
        node, *state = unpacked(reply.data)
        assert node == NODE
        steps = np.array([2 * P_MAX / 0xFFFF, 2 * V_MAX / 0xFFF, 2 * T_MAX / 0xFFF])
        off = np.array([1.2345, -3.21, 4.5]) - state
        assert (off > -1e-5).all()  # cut off, not rounded; an encoder's step beside that
        assert (off < steps + 1e-5).all()
        assert list(reply.data[6:]) == [25 + 40, 0]


def test_older_firmware_replies_with_six_bytes_to_the_masters_identifier():
    bench = Bench(reply_bytes=6, reply_identifier=0x50)
    assert bench.say(ENTER) == CanFrame(0x50, bench.sent[0].data)
    assert len(bench.sent[0].data) == 6


def test_torque_is_that_of_the_loop_where_the_joint_is():
    bench = Bench()
    bench.at(0.5, 0.2)
    bench.say(ENTER)
    assert bench.drive.demand() == AT_REST  # nothing was commanded yet
    bench.say(command(p=0.51, v=0.3, kp=100.0, kd=2.0, t=3.0))
    wanted = 100.0 * 0.01 + 2.0 * 0.1 + 3.0
    assert bench.drive.demand().torque_nm == pytest.approx(wanted, abs=0.1)
    loop = bench.drive.demand().loop
    assert loop.torque_nm(0.52, 0.2) == pytest.approx(wanted - 2.0, abs=0.1)
    assert loop.torque_nm(-0.5, 0.2) == 15.0  # the motor's limit
    bench.say(command(t=3.0))
    assert bench.drive.demand().loop is None
    assert bench.drive.demand().torque_nm == pytest.approx(3.0, abs=0.01)


def test_commands_count_in_motor_mode_only():
    bench = Bench()
    bench.say(command(t=5.0))
    assert bench.drive.demand() == AT_REST
    bench.say(ENTER)
    assert bench.drive.demand() == AT_REST
    bench.say(command(t=5.0))
    assert bench.drive.demand().is_released
    bench.say(EXIT)
    assert bench.drive.demand() == AT_REST


def test_zero_makes_positions_relative_on_both_ways():
    bench = Bench()
    bench.at(1.0)
    bench.say(ENTER)
    assert unpacked(bench.say(ZERO).data)[1] == pytest.approx(0.0, abs=5e-4)
    bench.say(command(p=0.1, kp=50.0))
    assert bench.drive.demand().loop.target_rad == pytest.approx(1.1, abs=5e-4)


@pytest.mark.parametrize("watchdog_ms", [0, 50])
def test_the_last_command_stays_in_force_unless_a_timeout_is_set(watchdog_ms):
    bench = Bench(watchdog_ms=watchdog_ms)
    bench.say(ENTER)
    bench.drive.advance(1000 * MS)  # nothing to stop yet
    assert bench.drive.fault is None
    bench.say(command(t=5.0), 1000 * MS)
    bench.drive.advance(1050 * MS)
    assert bench.drive.demand().torque_nm == pytest.approx(5.0, abs=0.01)
    bench.drive.advance(1051 * MS)
    if not watchdog_ms:
        assert bench.drive.demand().torque_nm == pytest.approx(5.0, abs=0.01)
        return
    assert bench.drive.demand() == AT_REST
    assert bench.drive.fault == "command timeout"
    bench.say(ENTER, 1060 * MS)
    assert bench.drive.fault is None
    assert bench.drive.demand() == AT_REST


@pytest.mark.parametrize(
    ("fault", "temperature_c", "error"),
    [(DriveFault.OVER_TEMPERATURE, 110, 1), (DriveFault.ENCODER, 25, 5)],
)
def test_errors_are_told_and_latched_until_motor_mode_is_left(fault, temperature_c, error):
    bench = Bench()
    bench.say(ENTER)
    bench.say(command(t=1.0))
    bench.drive.inject(fault, 0)
    assert bench.drive.demand() == AT_REST
    assert list(bench.say(ENTER).data[6:]) == [temperature_c + 40, error]
    assert bench.say(EXIT).data[7] == error  # its cause is still there
    bench.drive.clear(fault, 0)
    assert bench.say(EXIT).data[7] == 0
    bench.drive.inject(DriveFault.DRIVE, 0)
    assert bench.say(ENTER).data[7] == 2
    bench.say(command(t=1.0))
    assert bench.drive.demand() == AT_REST
    assert bench.say(EXIT).data[7] == 0


def test_frames_that_are_no_commands_are_refused_and_change_nothing():
    bench = Bench()
    bench.say(ENTER)
    for frame in (CanFrame(NODE, b"\xff" * 6), CanFrame(NODE, is_remote=True)):
        with pytest.raises(InvalidMessageError):
            bench.drive.receive(frame, 0)
    assert not bench.drive.receive(CanFrame(NODE + 1, ENTER), 0)
    assert bench.drive.targets == 0


def test_frames_in_words():
    bench = Bench(ranges=MitRanges(torque_nm=40.0))
    describe = bench.drive.describe
    assert describe(CanFrame(NODE, ENTER)) == "drive 5 enable"
    assert "torque_nm" in describe(CanFrame(NODE, command()))
    assert describe(bench.say(ENTER)).startswith("reply node_id 5, position_rad")
    assert describe(CanFrame(9, ENTER)) is None


ARM = (4.0, 8.0, 2000.0, 200.0, 400.0)
ARM_OPTIONS = dict(
    zip(
        ("position_rad", "velocity_rad_s", "stiffness_nm_rad", "damping_nm_s", "torque_nm"),
        ARM, strict=True,
    )
)  # fmt: skip


def test_a_client_that_knows_nothing_of_us_pushes_a_joint():
    """Over python-can, as examples for AK motors do it: say something, read the reply."""
    push = command(t=PUSH_NM, ranges=ARM)
    pushed_nm = to_float((push[6] & 0xF) << 8 | push[7], -ARM[4], ARM[4], 12)
    with (
        Rig("mit", mit=ARM_OPTIONS) as rig,
        can.Bus(interface="virtual", channel=rig.channel) as bus,
    ):

        def say(data):
            bus.send(can.Message(arbitration_id=NODE_ID, data=data, is_extended_id=False))
            message = bus.recv(PATIENCE_S)
            node_id, position, velocity, _ = unpacked(message.data, ARM)
            assert (message.arbitration_id, node_id) == (0, NODE_ID)
            return position, velocity

        assert say(ENTER)[0] == pytest.approx(START[JOINT], abs=2e-4)
        moved = [0.0, 0.0]

        def has_moved():
            moved[:] = say(push)
            return abs(moved[0] - START[JOINT]) > 0.3

        until(has_moved)
        half = np.array([ARM[0] / 0xFFFF, ARM[1] / 0xFFF])  # replies are cut off
        position, velocity = moved + half
        assert_energy_agrees(pushed_nm, position, velocity)

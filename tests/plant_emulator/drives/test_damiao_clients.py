"""Clients of others, unmodified, move an emulated OpenArm; and what they say if they cannot.

LeRobot's `DamiaoMotorsBus` waits for 1 ms for an answer, so on a busy machine it may miss some:
what it does is repeated until it has worked.
"""

from __future__ import annotations

import logging
import struct
from contextlib import contextmanager

import can
import numpy as np
import pytest

from bus_schema.link.can_configuration import DamiaoConfiguration
from deploy.scenario.scenario import load_setup
from plant_emulator.drives.drive import DriveFault
from tests.plant_emulator.drives.damiao_clients import DAMIAO_MOTOR, fetch_lerobot, fetch_wheel
from tests.plant_emulator.drives.test_clients import PATIENCE_S, Rig
from tests.waiting import await_true

SETUP = load_setup("openarm", [])
START = np.array([0.3, 0.2, -0.2, 1.0, 0.1, 0.2, -0.3])
OPENARM = (SETUP.robot, SETUP.scenario.plant, START)
MOTORS = SETUP.scenario.link.can.damiao.motor
GAINS = {"Kp": [240, 240, 240, 240, 24, 31, 25], "Kd": [5, 5, 3, 5, 0.3, 0.3, 0.3]}
"""Those of its `OpenArmFollowerConfig`."""

FD = {"fd": True, "data_bitrate": 5_000_000, "fd_process_data": True}
MODES = {"MIT": 1, "POS_VEL": 2, "VEL": 3, "FORCE_POS": 4}
NAMES = [f"joint_{number}" for number in range(1, 8)]


@pytest.fixture(scope="module")
def motors(request):
    """LeRobot's package of motors."""
    fetch_lerobot(request.config.cache.mkdir("wheels"))
    from lerobot.motors import Motor, MotorNormMode
    from lerobot.motors.damiao import DamiaoMotorsBus

    def build(rig, **options):
        return DamiaoMotorsBus(
            rig.channel,
            {
                name: Motor(id_, kind.lower(), MotorNormMode.DEGREES, kind.lower(), id_ + 0x10)
                for id_, (name, kind) in enumerate(zip(NAMES, MOTORS, strict=True), start=1)
            },
            can_interface="virtual",
            **options,
        )

    return build


def rig_of(**given):
    """An emulated OpenArm on a bus."""
    return Rig("damiao", arm=OPENARM, damiao=DamiaoConfiguration(motor=MOTORS), **given)


@contextmanager
def connected(bus):
    """Connect as often as it takes."""

    def try_it():
        try:
            bus.connect()
        except ConnectionError:
            bus.canbus.shutdown()
            return False
        return True

    await_true(try_it)
    try:
        yield bus
    finally:
        bus.disconnect()


def degrees(bus, name="Present_Position"):
    return np.array(list(bus.sync_read(name).values()))


@pytest.mark.parametrize("use_can_fd", [True, False], ids=["FD", "classical"])
def test_lerobot_connects_configures_reads_moves_and_disconnects(motors, use_can_fd):
    with rig_of(**FD if use_can_fd else {}) as rig:
        with connected(motors(rig, use_can_fd=use_can_fd)) as bus:
            bus.configure_motors()
            await_true(lambda: np.allclose(degrees(bus), np.degrees(START), atol=0.05))
            assert set(degrees(bus, "Temperature_Rotor")) == {25.0}
            for name, values in GAINS.items():
                bus.sync_write(name, dict(zip(NAMES, values, strict=True)))
            target = np.degrees(START) + 10.0
            goals = dict(zip(NAMES, target.tolist(), strict=True))

            def has_arrived():
                bus.sync_write("Goal_Position", goals)
                return np.abs(degrees(bus) - target).max() < 3.0  # gravity against 240 N m/rad

            await_true(has_arrived)
            states = bus.sync_read_all_states()
            assert abs(states["joint_2"]["torque"]) < 40.0
        assert bus.canbus is None
        await_true(lambda: all("DISABLED" in each for each in rig.bank.statuses))
        assert rig.bank.braked.all()
    assert rig.bank.rejections.counts == {}


def test_lerobot_makes_zero(motors):
    with rig_of(**FD) as rig, connected(motors(rig)) as bus:

        def is_zero():
            bus.set_zero_position(["joint_4"])
            return abs(bus.sync_read("Present_Position", ["joint_4"])["joint_4"]) < 0.05

        await_true(is_zero)


def test_missing_fd_flag_shows_as_motors_that_do_not_answer(motors):
    """The client's default is FD, and these motors are set to classical frames."""
    with rig_of() as rig:
        with pytest.raises(ConnectionError, match="Handshake failed") as failed:
            motors(rig).connect()
        assert str(NAMES) in str(failed.value)
        assert rig.bank.rejections.counts == {"no_classical_frame": 7}


def test_wrong_mode_shows_as_an_arm_that_does_not_move(motors, caplog):
    """Someone has left a motor in velocity mode: it has no answer to MIT commands."""
    with rig_of(**FD) as rig, connected(motors(rig)) as bus:
        data = struct.pack("<HBBI", 4, 0x55, 10, 3)
        with can.Bus(interface="virtual", channel=rig.channel) as other:
            other.send(can.Message(arbitration_id=0x7FF, data=data, is_extended_id=False))
            await_true(lambda: "ENABLED (VEL)" in rig.bank.statuses[3])
        caplog.set_level(logging.DEBUG)
        while bus.canbus.recv(0.05):  # else it would take the answer to the other for a state
            pass
        bus.write("Goal_Position", "joint_4", 90.0)
        assert "No response from joint_4 after MIT control command" in caplog.text
        await_true(lambda: rig.bank.rejections.counts == {"wrong_mode": 1})
        assert rig.bank.braked[3]
        await_true(lambda: abs(degrees(bus)[3] - np.degrees(START[3])) < 0.05)


def test_lost_motor_shows_as_its_last_known_state(motors, caplog):
    with rig_of(**FD) as rig, connected(motors(rig)) as bus:
        await_true(lambda: np.allclose(degrees(bus), np.degrees(START), atol=0.05))
        rig.bank.inject(4, DriveFault.SILENT, 0)
        caplog.clear()

        def is_missed():  # not at once: answers to earlier requests may still be on their way
            last = degrees(bus)[4]
            assert last == pytest.approx(np.degrees(START[4]), abs=0.05)
            return "Packet drop: joint_5 (ID: 0x15). Using last known state" in caplog.text

        await_true(is_missed)

        def read_fails():
            try:
                bus.read("Present_Position", "joint_5")
            except ConnectionError as error:
                return "No response from motor 'joint_5'" in str(error)
            return False

        await_true(read_fails)
    with rig_of(**FD) as rig:
        rig.bank.inject(4, DriveFault.SILENT, 0)

        def only_the_lost_one_is_missed():
            with pytest.raises(ConnectionError) as failed:
                motors(rig).connect()
            return "did not respond: ['joint_5']" in str(failed.value)

        await_true(only_the_lost_one_is_missed)


@contextmanager
def motor_of_damiao_motor(request, rig):
    """Joint 4 of the arm in the package damiao-motor, which takes classical frames alone."""
    fetch_wheel("damiao-motor", DAMIAO_MOTOR, request.config.cache.mkdir("wheels"))
    from damiao_motor.core.controller import DaMiaoController

    controller = DaMiaoController(channel=rig.channel, bustype="virtual")
    try:
        yield controller.add_motor(4, 0x14, "4340", v_max=8.0, v_min=-8.0)
    finally:
        controller.shutdown()


def test_damiao_motor_reads_and_writes_registers_and_moves_in_every_mode(request):
    with rig_of(tuned=SETUP.tuned_drive) as rig, motor_of_damiao_motor(request, rig) as motor:
        assert motor.get_register(8, timeout=PATIENCE_S) == 4
        assert motor.get_register(23, timeout=PATIENCE_S) == 28.0
        drive = {
            "POS_VEL": lambda to: motor.send_cmd_pos_vel(to, 0.8),
            "FORCE_POS": lambda to: motor.send_cmd_force_pos(to, 0.8, 0.9),
            "MIT": lambda to: motor.send_cmd_mit(to, 0.0, 300.0, 5.0, 0.0),
            "VEL": lambda to: motor.send_cmd_vel(0.3 if to > motor.state["pos"] else -0.3),
        }
        motor.enable()
        for number, (mode, send) in enumerate(drive.items()):
            motor.write_register(10, MODES[mode])
            motor.registers.pop(10, None)  # it keeps what it has read, so its own check must fail
            assert motor.get_register(10, timeout=PATIENCE_S) == MODES[mode]
            target = START[3] + (0.3 if number % 2 else 0.6)

            def has_arrived(send=send, target=target):
                send(target)
                return abs(motor.state["pos"] - target) < 0.05

            await_true(has_arrived)
        assert motor.state["status"] == "ENABLED"
        assert motor.state["t_rotor"] == 25.0


def test_damiao_motor_shows_a_timeout_and_clears_it(request):
    with rig_of() as rig, motor_of_damiao_motor(request, rig) as motor:
        motor.set_can_timeout(20)
        motor.enable()
        motor.send_cmd_mit(START[3], 0.0, 100.0, 3.0, 0.0)
        await_true(lambda: "LOST_COMMUNICATION" in rig.bank.statuses[3])
        motor.request_motor_feedback()
        await_true(lambda: motor.state["status"] == "LOST_COMM")
        motor.clear_error()
        await_true(lambda: motor.state["status"] == "DISABLED")

"""The emulated research interface: messages, moves, reflexes, and pylibfranka itself."""

import json
import os
import random
import socket
import struct
import subprocess
import sys
from importlib.util import find_spec

import numpy as np
import pytest

from bus_schema.franka import states
from bus_schema.franka.commands import Command, RequestReader, answer
from deploy.run.network.robot_network import RobotNetwork
from plant_emulator.interfaces.franka import FrankaMotionSettings
from plant_emulator.robot_servers.franka.server import FrankaServer
from tests.plant_emulator.robot_servers.served import HOST, client_that_leaves, free_port, robot
from tests.waiting import HANG_S, await_true

H = 1e-3
HEADER = struct.Struct("<3I")
REST = np.zeros((2, 7))
SCENARIO = ("robot.initial_offset_rad=0", "controller.law=position_correction")


def test_states_and_targets_have_the_sizes_of_libfrankas_structs():
    """Packed: 8 + 4 × 320 floats + 2 modes + 2 × 41 errors + 1 mode + 4; 8 + 8 × 45 + 3 flags."""
    assert states.STATE.itemsize == 1377
    assert states.TARGET.itemsize == 371


class Wire:
    """Stands for the sockets of a server: what it sends stays here."""

    def __init__(self):
        self.answers, self.sent = [], []

    def send(self, _client, data):
        self.answers.append((*HEADER.unpack_from(data), data[12]))

    def sendto(self, data, _place):
        self.sent.append(np.frombuffer(data, states.STATE)[0])


def connected(**settings):
    """A server at rest at zero whose client is connected."""
    server, wire = FrankaServer(FrankaMotionSettings(**settings), H, lambda _: None), Wire()
    server.interface.start(np.zeros(7))
    server._client = wire
    server._place, server._tcp, server._udp = ("", 1), wire, wire
    return server, wire


def command(server, number, payload=b"", name=Command.MOVE):
    data = HEADER.pack(name, number, 12 + len(payload)) + payload
    [request] = RequestReader().take(data)
    server._obey(server._client, request)


def move(server, number=1, controller=0, generator=0):
    command(server, number, struct.pack("<2I6d", controller, generator, *6 * [1.0]))


def cycle(server, number, **target):
    """A cycle, with a target that answers the newest state, or with none."""
    if target:
        row = np.zeros(1, states.TARGET)
        row["message_id"] = server._state["message_id"]
        for name, value in target.items():
            row[name] = value
        server._take_target(row.tobytes())
    server.interface.step(None, REST)
    server.cycle(number * H, server.interface.planned, np.zeros(7))


def held(server, count, first=0):
    for number in range(first, first + count):
        cycle(server, number, q_c=np.zeros(7))
    return first + count


def test_a_move_starts_runs_and_finishes():
    server, wire = connected()
    move(server, number=7)
    assert wire.answers == [(1, 7, 13, 1)]
    number = held(server, 50)
    assert (wire.sent[-1]["robot_mode"], wire.sent[-1]["motion_generator_mode"]) == (2, 1)
    assert wire.sent[-1]["control_command_success_rate"] == 1.0
    cycle(server, number, q_c=np.zeros(7), motion_generation_finished=1)
    assert wire.answers[-1] == (1, 7, 13, 0)
    assert (wire.sent[-1]["robot_mode"], wire.sent[-1]["motion_generator_mode"]) == (1, 0)


def test_success_rate_is_the_share_of_the_last_100_cycles():
    server, wire = connected()
    move(server)
    number = held(server, 100)
    for lost in range(10):
        cycle(server, number + lost)
    assert wire.sent[-1]["control_command_success_rate"] == pytest.approx(0.9)


def test_the_twentieth_lost_target_is_a_reflex_until_error_recovery():
    server, wire = connected()
    move(server, number=3)
    number = held(server, 5)
    for lost in range(19):
        cycle(server, number + lost)
    assert wire.sent[-1]["robot_mode"] == 2
    cycle(server, number + 19)
    state = wire.sent[-1]
    assert state["robot_mode"] == 4
    assert np.flatnonzero(state["reflex_reason"]).tolist() == [25]
    assert wire.answers[-1] == (1, 3, 13, 8)
    [stop] = server.counts["stops"]
    assert stop["is_fault"]
    assert stop["reason"].startswith("communication_constraints_violation: 20 ")
    move(server, number=4)
    assert wire.answers[-1] == (1, 4, 13, 5)  # not possible now
    command(server, 5, name=Command.AUTOMATIC_ERROR_RECOVERY)
    assert wire.answers[-1] == (10, 5, 13, 0)
    move(server, number=6)
    assert wire.answers[-1] == (1, 6, 13, 1)


def test_late_targets_count_as_lost():
    """They answer the state before the newest."""
    server, wire = connected()
    move(server)
    number = held(server, 5)
    for late in range(20):
        row = np.zeros(1, states.TARGET)
        row["message_id"] = server._state["message_id"] - 1
        server._take_target(row.tobytes())
        cycle(server, number + late)
    assert wire.sent[-1]["robot_mode"] == 4
    assert server.counts["late"] == 20


@pytest.mark.parametrize("controller", [0, 2])
def test_a_move_whose_targets_are_all_late_is_stopped(controller):
    server, wire = connected()
    move(server, controller=controller, generator=1)
    for number in range(25):
        row = np.zeros(1, states.TARGET)
        row["message_id"] = server._state["message_id"] - 1
        server._take_target(row.tobytes())
        cycle(server, number)
    assert wire.sent[-1]["robot_mode"] == 4
    assert np.flatnonzero(wire.sent[-1]["reflex_reason"]).tolist() == [25]
    assert np.isfinite(server.interface.planned).all()


def test_a_network_of_30_ms_each_way_makes_all_targets_late():
    """At 100 Hz, an answer is 6 cycles old."""
    port = free_port()
    delays = [f"link.{way}.delay_ms=30" for way in ("uplink", "downlink")]
    with (
        robot(
            FrankaServer, "panda_motors", "franka_position", {"commands": port}, *SCENARIO,
            *delays, "plant.interface.rate_hz=100",
            network=lambda setup: RobotNetwork(setup.link, 0),
        ) as (server, _),
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp,
        socket.create_connection((HOST, port)) as tcp,
    ):  # fmt: skip
        udp.bind((HOST, 0))
        udp.settimeout(HANG_S)
        connect = struct.pack("<2H", 10, udp.getsockname()[1])
        tcp.sendall(HEADER.pack(0, 0, 16) + connect)
        state, _ = udp.recvfrom(1 << 16)
        tcp.sendall(HEADER.pack(1, 1, 68) + struct.pack("<2I6d", 0, 0, *6 * [1.0]))
        row = np.zeros(1, states.TARGET)
        while not server.counts["stops"]:
            data, place = udp.recvfrom(1 << 16)
            state = np.frombuffer(data, states.STATE)[0]
            row["message_id"], row["q_c"] = state["message_id"], state["q_d"]
            udp.sendto(row.tobytes(), place)
    assert server.counts["stops"][0]["reason"].startswith("communication_constraints_violation")
    assert server.counts["late"] > 0


def test_a_jump_is_named_as_franka_does():
    """0.1 mrad in a cycle of 1 ms is 100 rad/s², of at most 10; libfranka's bit 14."""
    server, wire = connected()
    move(server)
    number = held(server, 5)
    cycle(server, number, q_c=np.full(7, 1e-4))
    assert np.flatnonzero(wire.sent[-1]["reflex_reason"]).tolist() == [14]


def test_velocities_and_torques_reach_their_interfaces():
    server, wire = connected(acceleration_rad_s2=1e6, jerk_rad_s3=1e12)
    move(server, generator=1)
    for number in range(10):
        cycle(server, number, dq_c=np.full(7, 0.1))
    assert server.interface.planned[1] == pytest.approx(7 * [0.1])
    server, wire = connected()
    move(server, controller=2, generator=1)
    cycle(server, 0, tau_J_d=np.zeros(7))
    cycle(server, 1, tau_J_d=np.full(7, 1.1))  # more than 1000 N m/s
    assert np.flatnonzero(wire.sent[-1]["reflex_reason"]).tolist() == [32]


@pytest.mark.parametrize("torque_nm", [1e308, -1e308, 1.1])
def test_the_first_torque_is_a_step_from_0_and_one_too_large_does_not_act(torque_nm):
    """1000 N m/s at 1 kHz are 1 N m in a cycle."""
    server, wire = connected()
    move(server, controller=2, generator=1)
    cycle(server, 0, tau_J_d=np.zeros(7))
    server._end(0)
    move(server, controller=2, generator=1)
    row = np.zeros(1, states.TARGET)
    row["message_id"], row["tau_J_d"] = server._state["message_id"], torque_nm
    server._take_target(row.tobytes())
    assert server.interface.step(None, REST).torque_nm.tolist() == 7 * [0.0]
    server.cycle(H, REST, np.zeros(7))
    assert np.flatnonzero(wire.sent[-1]["reflex_reason"]).tolist() == [32]


def test_the_desired_torque_is_without_gravity():
    """libfranka's limiter takes its first step from it: a client of zeros must get zeros."""
    server, wire = connected()
    gravity_nm = np.full(7, 20.0)
    server.cycle(0.0, REST, gravity_nm)
    move(server, controller=2, generator=1)
    for number in range(1, 3):
        cycle(server, number, tau_J_d=np.full(7, 0.5 * number))
        server.cycle((number + 0.5) * H, REST, gravity_nm)
    assert wire.sent[0]["tau_J"].tolist() == 7 * [20.0]
    assert wire.sent[0]["tau_J_d"].tolist() == 7 * [0.0]
    assert wire.sent[-1]["tau_J_d"].tolist() == 7 * [1.0]


def test_a_client_that_left_amid_its_requests_does_not_keep_the_robot():
    server = FrankaServer(FrankaMotionSettings(), H, lambda _: None)
    server.interface.start(np.zeros(7))
    connect = HEADER.pack(0, 1, 16) + struct.pack("<2H", 10, 5555)
    setting = HEADER.pack(Command.STOP_MOVE, 2, 12)
    with client_that_leaves(server) as (receive, leave):
        receive(connect)
        assert server._client is not None
        leave()
        receive(setting + connect)
    with client_that_leaves(server) as (receive, _):
        receive(connect)
        assert server._client is not None
        assert server._client.fileno() >= 0
    server.close()


def test_a_client_of_which_no_way_leads_back_does_not_keep_the_robot():
    server = FrankaServer(FrankaMotionSettings(), H, lambda _: None)
    connect = HEADER.pack(0, 1, 16) + struct.pack("<2H", 10, 5555)
    with client_that_leaves(server) as (receive, leave):
        leave()
        with pytest.raises(ValueError, match="it has gone"):
            receive(connect)
    assert server._client is None
    server.close()


@pytest.mark.parametrize(("generator", "behind"), [(2, b""), (3, b""), (9, b""), (0, b"\1")])
def test_moves_that_are_not_emulated_are_refused(generator, behind):
    server, wire = connected()
    command(server, 1, struct.pack("<2I6d", 0, generator, *6 * [1.0]) + behind)
    assert wire.answers == [(1, 1, 13, 7)]
    assert not server.interface.is_moved


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_targets_that_are_not_finite_are_ignored(bad):
    server, _ = connected()
    move(server)
    number = held(server, 5)
    cycle(server, number, q_c=[*6 * [0.0], bad])
    assert server.counts["invalid"] == 1
    assert np.isfinite(server.interface.planned).all()


def test_answers_repeat_command_and_number():
    [request] = RequestReader().take(HEADER.pack(10, 99, 12))
    assert answer(request, 2) == HEADER.pack(10, 99, 13) + b"\2"


PYLIBFRANKA = """
import json, math, sys, time
from pylibfranka import *

robot = Robot(sys.argv[1], RealtimeConfig.kIgnore)
found = {"q": list(robot.read_once().q)}
robot.set_collision_behavior(7 * [20.0], 7 * [20.0], 6 * [20.0], 6 * [20.0])

def run(control, target, duration_s):
    state, _ = control.readOnce()
    begun_s, home, moved_s = state.time.to_sec(), list(state.q_d), 0.0
    while moved_s < duration_s:
        command = target(moved_s, home)
        control.writeOnce(command)
        state, _ = control.readOnce()
        moved_s = state.time.to_sec() - begun_s
    rate = state.control_command_success_rate
    command = target(duration_s, home)
    command.motion_finished = True
    control.writeOnce(command)
    end_s = time.monotonic() + 5.0
    while robot.read_once().robot_mode == RobotMode.Move and time.monotonic() < end_s:
        control.writeOnce(command)
    time.sleep(0.2)
    return rate

def position(time_s, home):
    share = min(time_s, 0.5) / 0.5
    return JointPositions([*home[:6], home[6] + 0.025 * (1 - math.cos(math.pi * share))])

control = robot.start_joint_position_control(ControllerMode.JointImpedance)
found["rate"] = run(control, position, 1.0)
found["moved"] = robot.read_once().q[6] - found["q"][6]

control = robot.start_joint_velocity_control(ControllerMode.JointImpedance)
before = robot.read_once().q[6]
run(control, lambda t, _: JointVelocities(6 * [0.0] + [0.2 * math.sin(math.pi * t / 0.5)]), 0.5)
found["turned"] = robot.read_once().q[6] - before

control = robot.start_torque_control()
before = robot.read_once().q
run(control, lambda t, _: Torques(7 * [0.0]), 0.3)
found["sagged"] = max(abs(a - b) for a, b in zip(robot.read_once().q, before))

control = robot.start_joint_position_control(ControllerMode.JointImpedance)
for _ in range(5):
    state, _ = control.readOnce()
    control.writeOnce(JointPositions(state.q_d))
time.sleep(1.0)  # without targets
try:
    while True:
        state, _ = control.readOnce()
        control.writeOnce(JointPositions(state.q_d))
except ControlException as error:
    found["error"] = str(error)
robot.automatic_error_recovery()
time.sleep(0.2)
state = robot.read_once()
found["recovered"] = state.robot_mode == RobotMode.Idle and not state.current_errors
print(json.dumps(found))
"""


@pytest.mark.skipif(find_spec("pylibfranka") is None, reason="pylibfranka is not installed")
def test_pylibfranka_unmodified_moves_a_joint_in_three_ways_and_recovers_from_a_reflex():
    """At 50 Hz and with the limiter, so that a busy machine keeps pace: 20 lost are 0.4 s."""
    port = 1337  # the client has no other
    host = f"127.1.{os.getpid() // 256 % 256}.{os.getpid() % 256 or 1}"  # of this run alone
    with robot(
        FrankaServer, "panda_motors", "franka_position", {"commands": port}, *SCENARIO,
        "plant.interface.rate_hz=50", "plant.interface.franka_position.limiter=true", host=host,
    ) as (server, _):  # fmt: skip
        command = [sys.executable, "-c", PYLIBFRANKA, host]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        assert done.returncode == 0, (done.stderr, server.said)
        found = json.loads(done.stdout.splitlines()[-1])
    assert len(found["q"]) == 7
    assert found["moved"] == pytest.approx(0.05, abs=0.02)
    assert found["turned"] == pytest.approx(0.2 * 0.5 * 2 / np.pi, rel=0.5)
    assert found["sagged"] < 0.05
    assert 0.0 < found["rate"] <= 1.0
    assert "communication_constraints_violation" in found["error"]
    assert found["recovered"]
    assert server.counts["stops"][-1]["reason"].startswith("communication_constraints_violation")


def test_no_bytes_end_the_server():
    """Garbage, half commands, resets, a second client, and random datagrams."""
    rng, port = random.Random(57), free_port()
    with robot(FrankaServer, "panda_motors", "franka_position", {"commands": port}, *SCENARIO) as (
        server,
        rig,
    ):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
            udp.bind((HOST, 0))
            udp.settimeout(HANG_S)
            first = socket.create_connection((HOST, port))
            connect = struct.pack("<2H", 10, udp.getsockname()[1])
            first.sendall((HEADER.pack(0, 0, 16) + connect)[:9])
            first.sendall((HEADER.pack(0, 0, 16) + connect)[9:])
            _, robot_udp = udp.recvfrom(1 << 16)
            first.sendall(HEADER.pack(1, 1, 68) + struct.pack("<2I6d", 0, 0, *6 * [1.0]))
            for _ in range(40):
                with socket.create_connection((HOST, port)) as other:
                    if rng.random() < 0.5:
                        linger = struct.pack("ii", 1, 0)
                        other.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
                    size = rng.choice([12, 16, 68, 2**31, 0])
                    head = HEADER.pack(rng.randrange(15), rng.randrange(9), size)
                    other.sendall(head + rng.randbytes(rng.randrange(80)))
                udp.sendto(rng.randbytes(rng.choice([0, 5, 371])), robot_udp)
            first.sendall(HEADER.pack(77, 2, 12) + HEADER.pack(3, 3, 12 + 416) + b"\xff" * 416)
            await_true(lambda: server.counts["invalid"] > 0)
            first.close()
            await_true(lambda: server._client is None)
        ticks = rig.ticks
        await_true(lambda: rig.ticks > ticks + 10)
        assert np.isfinite(server.interface.planned).all()

"""The emulated xArm controller: messages, servo mode, stops, and xarm-python-sdk itself."""

import json
import random
import socket
import struct
import subprocess
import sys
from importlib.util import find_spec

import numpy as np
import pytest

from bus_schema.xarm.messages import CommandReader, Detail, report
from plant_emulator.interfaces.servoj import ServoJSettings
from plant_emulator.robot_servers.xarm.server import XArmServer
from tests.plant_emulator.robot_servers.served import HOST, client_that_leaves, free_port, robot
from tests.waiting import HANG_S, await_true

H = 4e-3
SCENARIO = ("controller.law=streaming", "robot.initial_offset_rad=0")
CLIENT = object()


def ready():
    """A server without sockets, with six joints at rest at zero, in servo mode."""
    server = XArmServer(ServoJSettings(), H, lambda _: None)
    server.interface.start(np.zeros(6))
    server.cycle(0.0, np.zeros((2, 6)), np.zeros(6))
    for function, payload in ((11, b"\x08\x01"), (19, b"\x01\x00"), (12, b"\x00")):
        assert ask(server, function, payload)[0] & 0x08 == 0
    return server


def ask(server, function, payload=b""):
    """State and payload of the answer to a command, by hand."""
    data = struct.pack(">3HB", 5, 2, len(payload) + 1, function) + payload
    [command] = CommandReader().take(data)
    answer = server._answered(CLIENT, command)
    number, protocol, length = struct.unpack_from(">3H", answer)
    assert (number, protocol, length, answer[6]) == (5, 2, len(answer) - 6, function)
    return answer[7], answer[8:]


def servo(server, *position, zeros=4):
    return ask(server, 29, struct.pack("<10f", *position, *(10 - len(position)) * [0.0]))[0]


def cycles(server, count, first=1):
    for number in range(first, first + count):
        server.interface.step(None, np.zeros((2, 6)))
        server.cycle(number * H, server.interface.planned, np.zeros(6))
    return server.interface.planned


def test_servo_targets_are_reached_and_held():
    """Critically damped, 15 time constants after the target; then nothing moves any more."""
    server = ready()
    assert servo(server, *6 * [0.1]) == 0
    assert cycles(server, 500)[0] == pytest.approx(6 * [0.1], abs=1e-4)
    assert ask(server, 13)[1] == b"\x02"
    assert server.target_rad == pytest.approx(6 * [0.1])


def test_a_mode_above_15_is_refused_and_stops_nothing():
    server = ready()
    servo(server, *6 * [1.0])
    assert ask(server, 19, b"\x11")[0] & 0x08 == 0x08
    assert server.interface.is_moved
    assert server.counts["stops"] == []


def test_a_client_that_left_amid_its_commands_moves_nothing():
    server = ready()
    state = struct.pack(">3HB", 1, 2, 1, 13)
    target = struct.pack(">3HB", 2, 2, 41, 29) + struct.pack("<10f", *10 * [0.5])
    with client_that_leaves(server) as (receive, leave):
        leave()
        receive(state + target)
    assert not server.interface.is_moved
    assert server._mover is None
    server.close()


def test_a_state_of_4_brakes_and_refuses_targets():
    server = ready()
    servo(server, *6 * [1.0])
    assert (cycles(server, 20)[1] > 0.0).all()
    ask(server, 12, b"\x04")
    assert servo(server, *6 * [1.0]) & 0x10
    assert cycles(server, 100)[1] == pytest.approx(6 * [0.0], abs=1e-12)
    assert ask(server, 13)[1] == b"\x04"
    assert server.counts["stops"] == [
        {"time_s": pytest.approx(20 * H), "reason": "state 4 set by the client", "is_fault": False}
    ]


def test_without_enabling_servo_mode_or_state_0_nothing_moves():
    server = XArmServer(ServoJSettings(), H, lambda _: None)
    server.interface.start(np.zeros(6))
    assert servo(server, *6 * [1.0]) & 0x10
    ask(server, 11, b"\x08\x01")
    assert servo(server, *6 * [1.0]) & 0x10
    ask(server, 12, b"\x00")
    servo(server, *6 * [1.0])  # in position mode
    assert not server.interface.is_moved


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e30])
def test_targets_that_are_no_usable_number_are_refused(bad):
    server = ready()
    servo(server, *6 * [0.1])
    assert servo(server, *5 * [0.1], bad) & 0x08
    assert cycles(server, 500)[0] == pytest.approx(6 * [0.1], abs=1e-4)
    assert server.counts["invalid"] == 1


@pytest.mark.parametrize(
    ("function", "payload"), [(29, b"\0" * 39), (12, b""), (12, b"\x07"), (11, b"\x01"), (21, b"")]
)
def test_commands_that_are_malformed_or_not_emulated_are_refused(function, payload):
    assert ask(ready(), function, payload)[0] & 0x08


def test_joints_have_as_many_rows_as_are_asked_for():
    server = ready()
    server.cycle(H, np.array([6 * [0.5], 6 * [0.25]]), np.full(6, 2.0))
    found = struct.unpack("<14f", ask(server, 42, b"\x02")[1])
    assert found == (*6 * [0.5], 0.0, *6 * [0.25], 0.0)
    assert len(ask(server, 42)[1]) == 28


def test_reports_have_the_sizes_that_clients_read():
    """87, 145 and 245 bytes; the first four give the size."""
    for detail, size in zip(Detail, (87, 145, 245), strict=True):
        data = report(2, 1, 7 * [0.5], 7 * [1.0], 6, enabled=True, detail=detail)
        assert len(data) == struct.unpack_from(">I", data)[0] == size
        assert data[4] == 0x12
        assert struct.unpack_from("<7f", data, 7) == tuple(7 * [0.5])


XARM = """
import json, sys, time
from xarm.wrapper import XArmAPI

arm = XArmAPI(sys.argv[1], is_radian=True, check_joint_limit=False)
found = {"axes": arm.axis, "codes": [arm.motion_enable(True), arm.set_mode(1), arm.set_state(0)]}
code, home = arm.get_servo_angle()
target = list(home)
for _ in range(50):
    target[5] += 0.002
    found["codes"].append(arm.set_servo_angle_j(target))
    time.sleep(0.004)
end_s = time.monotonic() + 5.0
while abs(arm.get_servo_angle()[1][5] - target[5]) > 1e-3 and time.monotonic() < end_s:
    time.sleep(0.02)
found["moved"] = arm.get_servo_angle()[1][5] - home[5]
while (arm.mode != 1 or abs(arm.angles[5] - target[5]) > 1e-3) and time.monotonic() < end_s:
    time.sleep(0.02)
found["reported"] = arm.angles[5] - home[5]
found["stop"] = [arm.set_state(4), arm.get_state()[1], arm.set_servo_angle_j(home)]
arm.disconnect()
print(json.dumps(found))
"""


@pytest.mark.skipif(find_spec("xarm") is None, reason="xarm-python-sdk is not installed")
def test_xarm_python_sdk_unmodified_servos_a_joint_and_stops_it():
    host = "127.0.0.66"
    try:
        socket.create_server((host, 502)).close()  # the client has no other port
    except PermissionError:
        pytest.skip("only root may listen at port 502 on this machine")
    with robot(XArmServer, "ur5e_motors", "servoj", XArmServer.ports, *SCENARIO, host=host) as (
        server,
        _,
    ):
        command = [sys.executable, "-c", XARM, host]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        assert done.returncode == 0, (done.stderr, server.said)
        found = json.loads(done.stdout.splitlines()[-1])
    assert found["axes"] == 6
    assert set(found["codes"]) == {0}
    assert found["moved"] == pytest.approx(0.1, abs=2e-3)
    assert found["reported"] == pytest.approx(0.1, abs=2e-3)
    assert found["stop"] == [0, 4, 9]
    assert server.counts["stops"][0]["reason"] == "state 4 set by the client"


def test_no_bytes_end_the_server():
    """Garbage, half commands, resets and two clients; one vanishes while it moves the arm."""
    rng, port, reports = random.Random(57), free_port(), free_port()
    ports = {"commands": port, "rich report": reports}
    with robot(XArmServer, "ur5e_motors", "servoj", ports, *SCENARIO) as (server, rig):
        mover = socket.create_connection((HOST, port))
        for function, payload in ((11, b"\x08\x01"), (19, b"\x01"), (12, b"\x00")):
            mover.sendall(struct.pack(">3HB", 1, 2, len(payload) + 1, function) + payload)
        await_true(lambda: server.interface.planned.size)
        target = struct.pack("<10f", *server.interface.planned[0], *4 * [0.0])
        data = struct.pack(">3HB", 1, 2, 41, 29) + target
        mover.sendall(data[:11])
        mover.sendall(data[11:])
        with socket.create_connection((HOST, reports), timeout=HANG_S) as reader:
            assert reader.recv(4) == struct.pack(">I", 245)
        await_true(lambda: server.counts["targets"] == 1)
        for _ in range(40):
            with socket.create_connection((HOST, port)) as other:
                if rng.random() < 0.5:
                    linger = struct.pack("ii", 1, 0)
                    other.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
                head = struct.pack(">3H", 1, rng.choice([0, 1, 2, 3]), rng.choice([0, 1, 9, 41]))
                other.sendall(head + rng.randbytes(rng.randrange(80)))
        mover.close()
        await_true(lambda: server.counts["stops"])
        assert server.counts["stops"][0]["reason"].startswith(("the client", "state", "mode"))
        ticks = rig.ticks
        await_true(lambda: rig.ticks > ticks + 10)
        assert np.isfinite(server.interface.planned).all()

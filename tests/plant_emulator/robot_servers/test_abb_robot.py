"""The emulated ABB controller under EGM: its messages, its session, and abb-robot-client itself."""

import math
import random
import socket
import time
from importlib.util import find_spec

import numpy as np
import pytest

from bus_schema.egm.messages import MCI_RUNNING, read_correction, robot_message
from deploy.run.network.robot_network import RobotNetwork
from plant_emulator.interfaces.egm import EgmSettings
from plant_emulator.robot_servers.abb.server import EgmServer
from tests.plant_emulator.robot_servers.served import free_port, robot
from tests.waiting import HANG_S, await_true

H = 4e-3
SENSOR = ("controller.law=position_correction", "robot.initial_offset_rad=0")
needs_client = pytest.mark.skipif(
    find_spec("abb_robot_client") is None, reason="abb-robot-client is not installed"
)
MOST = {"joints": 6, "most_rad": 12.0, "most_rad_s": 12.0}


def server_with(**settings):
    """A server without sockets, at rest at zero."""
    found = EgmServer(EgmSettings(**settings), H, lambda _: None)
    found.interface.start(np.zeros(6))
    found.sent, found._client = [], ("", 0)
    found._socket = type("Wire", (), {"sendto": lambda _, data, to: found.sent.append(data)})()
    return found


def cycle(server, number, correction=None):
    if correction is not None:
        server._take(correction)
    server.interface.step(None, np.zeros((2, 6)))
    server.cycle(number * H, server.interface.planned, np.zeros(6))


def varint(value):
    low = bytes([value & 0x7F | (0x80 if value > 0x7F else 0)])
    return low + (varint(value >> 7) if value > 0x7F else b"")


def field(number, payload):
    return varint(number << 3 | 2) + varint(len(payload)) + payload


def doubles(values):
    """A repeated double of proto2: each with its own tag."""
    return b"".join(b"\x09" + np.float64(value).tobytes() for value in values)


def sensor(position_deg=(), speed_deg_s=()):
    """An EgmSensor, by hand, after the encoding of protobuf."""
    planned = field(2, field(1, doubles(position_deg))) if len(position_deg) else b""
    speed = field(3, field(1, doubles(speed_deg_s))) if len(speed_deg_s) else b""
    return field(1, b"\x08\x01\x18\x03") + planned + speed


def test_corrections_are_read_in_degrees():
    found = read_correction(sensor(6 * [90.0], 6 * [-180.0]), **MOST)
    assert found.position_rad == pytest.approx(6 * [math.pi / 2])
    assert found.velocity_rad_s == pytest.approx(6 * [-math.pi])
    assert read_correction(sensor((), 6 * [1.0]), **MOST).position_rad is None


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (sensor(5 * [0.0]), "planned: 5 joints: must be 6"),
        (sensor([*5 * [0.0], np.nan]), "planned: joint 5 = nan: must be within ±687.549"),
        (sensor((), [np.inf, *5 * [0.0]]), "speedRef: joint 0 = inf: must be within"),
        (sensor([1e300, *5 * [0.0]]), "planned: joint 0 = 1e\\+300: must be within"),
        (sensor(), "without planned.joints and speedRef.joints"),
        (b"\xff" * 9, "no EgmSensor"),
        (sensor(6 * [1.0])[:-3], "no EgmSensor"),
    ],
)
def test_messages_that_cannot_be_used_are_refused(data, words):
    with pytest.raises(ValueError, match=words):
        read_correction(data, **MOST)


@needs_client
def test_the_state_is_what_abbs_own_description_reads():
    from abb_robot_client._egm_protobuf import egm_pb2

    measured, planned = np.full((2, 6), 0.5), np.full((2, 6), 0.25)
    message = egm_pb2.EgmRobot.FromString(
        robot_message(2**32 + 7, 1.5, measured, planned, MCI_RUNNING)
    )
    assert (message.header.seqno, message.header.tm, message.header.mtype) == (7, 1500, 2)
    assert list(message.feedBack.joints.joints) == pytest.approx(6 * [math.degrees(0.5)])
    assert list(message.planned.joints.joints) == pytest.approx(6 * [math.degrees(0.25)])
    assert message.mciState.state == egm_pb2.EgmMCIState.MCI_RUNNING
    assert message.motorState.state == egm_pb2.EgmMotorState.MOTORS_ON
    assert message.rapidExecState.state == egm_pb2.EgmRapidCtrlExecState.RAPID_RUNNING


def test_a_position_is_reached_exponentially_by_gain_and_filter():
    """x'' = w (k (1 - x) - x'), with k = 5/s and w = 2π 20 rad/s, here sampled."""
    server, w, k = server_with(gain_per_s=5.0), 2 * math.pi * 20, 5.0
    for number in range(101):
        cycle(server, number, sensor(6 * [10.0]))
    slow, fast = np.roots([1.0, w, w * k])[::-1]
    t = 100 * H
    wanted = 1 - (fast * np.exp(slow * t) - slow * np.exp(fast * t)) / (fast - slow)
    assert np.degrees(server.interface.planned[0]) == pytest.approx(6 * [10 * wanted], abs=0.2)


def test_a_speed_passes_the_low_pass_alone():
    """The step response of 20 Hz: v (1 - exp(-w t))."""
    server, server_speed = server_with(), []
    for number in range(10):
        cycle(server, number, sensor((), 6 * [30.0]))
        server_speed.append(math.degrees(server.interface.planned[1][0]))
    t = H * np.arange(10)
    assert server_speed == pytest.approx(30 * (1 - np.exp(-2 * math.pi * 20 * t)), rel=1e-9)


def test_silence_stops_the_motion_once_and_a_new_client_may_begin():
    server, deg = server_with(timeout_ms=100.0), 6 * [20.0]
    for number in range(5):
        cycle(server, number, sensor(deg))
    for number in range(5, 29):  # 24 cycles, 96 ms
        cycle(server, number)
    assert server.counts["stops"] == []
    cycle(server, 29)
    [stop] = server.counts["stops"]
    assert stop["reason"] == "egm_communication_timeout: no correction for 100 ms"
    assert stop["time_s"] == pytest.approx(29 * H)
    for number in range(30, 270):  # late corrections do not move it again
        cycle(server, number, sensor(deg))
    assert server.interface.is_at_rest
    for number in range(270, 525):  # silence for more than a second
        cycle(server, number)
    cycle(server, 525, sensor(deg))
    cycle(server, 526, sensor(deg))
    assert server.interface.is_moved
    assert len(server.counts["stops"]) == 1


@pytest.mark.parametrize("delay_ms", [0, 10])
@needs_client
def test_abb_robot_client_unmodified_moves_a_joint_and_a_timeout_stops_it(delay_ms):
    from abb_robot_client.egm import EGM

    port = free_port(socket.SOCK_DGRAM)
    delays = [f"link.{way}.delay_ms={delay_ms}" for way in ("uplink", "downlink")]

    def network(setup):
        return RobotNetwork(setup.link, 0) if delay_ms else None

    client = EGM(port)
    with robot(
        EgmServer, "ur5e_motors", "egm", {"egm": port}, *SENSOR, *delays, network=network
    ) as (server, _):
        ok, state = client.receive_from_robot(HANG_S)
        assert ok
        assert not state.rapid_running
        wanted = state.joint_angles.copy()
        wanted[5] += 5.0
        deadline_s = time.monotonic() + HANG_S
        while abs(state.joint_angles[5] - wanted[5]) > 0.1:
            assert time.monotonic() < deadline_s
            ok, state = client.receive_from_robot(HANG_S)
            assert ok
            assert client.send_to_robot(wanted, np.zeros(6))
        assert state.rapid_running
        await_true(lambda: server.counts["stops"])
        assert server.counts["stops"][0]["reason"].startswith("egm_communication_timeout")
    client.close()


def test_no_datagram_ends_the_server():
    """Mutated, truncated and random ones, and those of two clients."""
    rng, port = random.Random(57), free_port(socket.SOCK_DGRAM)
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
    ):
        client.bind(("127.0.0.1", port))
        client.settimeout(HANG_S)
        with robot(EgmServer, "ur5e_motors", "egm", {"egm": port}, *SENSOR) as (server, rig):
            _, address = client.recvfrom(1 << 16)
            for number in range(300):
                data = bytearray(sensor(6 * [rng.uniform(-9, 9)], 6 * [rng.uniform(-9, 9)]))
                for _ in range(rng.randrange(4)):
                    data[rng.randrange(len(data))] = rng.randrange(256)
                (client, other)[number % 2].sendto(data[: rng.randrange(len(data) + 1)], address)
                other.sendto(rng.randbytes(rng.randrange(80)), address)
            await_true(lambda: server.counts["invalid"] > 100)
            ticks = rig.ticks
            await_true(lambda: rig.ticks > ticks + 10)
            assert np.isfinite(server.interface.planned).all()

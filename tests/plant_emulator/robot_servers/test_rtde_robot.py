"""The emulated Universal Robots controller: motion, registers, ports, and ur-rtde itself."""

import socket
import struct
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from importlib.util import find_spec

import numpy as np
import pytest

from plant_emulator.interfaces.servoj import ServoJSettings
from plant_emulator.robot_servers.universal_robots.control_script import ControlScript
from plant_emulator.robot_servers.universal_robots.dashboard import answer
from plant_emulator.robot_servers.universal_robots.motion import ScriptMotion
from plant_emulator.robot_servers.universal_robots.rtde_port import RtdeClient
from plant_emulator.robot_servers.universal_robots.server import UniversalRobotsServer
from tests.plant_emulator.robot_servers import served
from tests.waiting import HANG_S

H = 2e-3
STATE = "output_int_register_0"
MEASURED = np.zeros((2, 6))


def motion():
    found = ScriptMotion(H, ServoJSettings())
    found.start(np.zeros(6))
    return found


def cycles(moved, count):
    for _ in range(count):
        moved.step(None, MEASURED)
    return moved.position[5], moved.velocity[5]


def test_speedj_accelerates_by_its_acceleration_and_goes_on():
    """v = a t up to 0.2 after 0.1 s; then 0.2 t. x = a t² / 2 of that."""
    moved = motion()
    moved.speed(np.full(6, 0.2), 2.0)
    assert cycles(moved, 25) == pytest.approx((0.5 * 2.0 * 0.05**2, 0.1))
    assert cycles(moved, 75) == pytest.approx((0.5 * 2.0 * 0.1**2 + 0.2 * 0.1, 0.2))
    moved.brake(4.0)
    assert cycles(moved, 25)[1] == pytest.approx(0.0, abs=1e-12)


def test_servoj_is_behind_a_ramp_by_its_dead_time_and_lag():
    """4 ms and lookahead (2/3 + 200/gain), and a target stays for a cycle."""
    moved, speed = motion(), 0.3
    for number in range(1000):
        moved.servo(np.full(6, speed * number * H), 0.1, 300.0)
        moved.step(None, MEASURED)
    behind_s = (speed * 1000 * H - moved.position[5]) / speed
    assert behind_s == pytest.approx(4e-3 + 0.1 * (2 / 3 + 200 / 300) + 0.5 * H, abs=0.5 * H)


def command(number, *floats):
    registers = {f"input_double_register_{k}": value for k, value in enumerate(floats)}
    return {"input_int_register_0": number, **registers}


def script():
    said = []
    found = ControlScript(motion(), H, said.append)
    found.begin()
    return found, said


def test_a_command_is_done_until_it_is_cleared_and_servoing_is_ready_at_once():
    program, _ = script()
    assert program.outputs[STATE] == 1
    program.take(command(26))
    assert program.outputs[STATE] == 2
    assert program.outputs["output_double_register_0"] == H
    program.take(command(0))
    assert program.outputs[STATE] == 1
    program.take(command(11, *6 * [0.5], 0, 0, H, 0.1, 300))
    assert program.outputs[STATE] == 1
    assert program.commands == {26: 1, 11: 1}


def test_a_watchdog_stops_the_program_and_the_arm():
    """At 10 Hz: silence of more than 100 ms."""
    program, _ = script()
    program.take(command(35, 10.0))
    program.cycle(0.05)
    program.take(command(0))
    program.take(command(9, *6 * [0.2], 2.0, 0))
    program.cycle(0.149)
    assert program.is_running
    program.cycle(0.151)
    assert not program.is_running
    assert program.stops == [(0.151, "watchdog: no input for 100 ms")]
    program.take(command(9, *6 * [0.2], 2.0, 0))
    assert cycles(program._motion, 100)[1] == 0.0


SERVO = (*6 * [0.1], 0, 0, H, 0.1, 300)
SPEED = (*6 * [0.1], 2.0, 0)


def changed(floats, number, value):
    return [value if each == number else old for each, old in enumerate(floats)]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
@pytest.mark.parametrize(
    ("number", "floats", "register"),
    [(11, SERVO, 0), (11, SERVO, 9), (11, SERVO, 10), (9, SPEED, 5), (9, SPEED, 6),
     (15, [1.0], 0), (16, [1.0], 0), (34, [1.0], 0), (35, [10.0], 0)],
)  # fmt: skip
def test_a_register_that_is_no_usable_number_ends_the_program_and_the_arm_stops(
    number, floats, register, bad
):
    program, _ = script()
    program.take(command(9, *6 * [0.2], 2.0, 0))
    cycles(program._motion, 50)
    program.take(command(number, *changed(floats, register, bad)))
    assert not program.is_running
    [(_, reason)] = program.stops
    assert reason.startswith(f"command {number}: ")
    assert f"= {bad:g}: must be within " in reason
    position, velocity = cycles(program._motion, 100)
    assert velocity == 0.0
    assert position == pytest.approx(0.5 * 2.0 * 0.1**2 + 0.5 * 0.2**2 / 20.0, abs=1e-3)
    program.begin()
    program.take(command(9, *6 * [0.2], 2.0, 0))
    assert cycles(program._motion, 100)[1] == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("number", "floats", "register", "bad"),
    [(9, SPEED, 6, -1.0), (16, [1.0], 0, -1.0), (35, [1.0], 0, -1.0), (11, SERVO, 9, 0.02),
     (11, SERVO, 9, 0.21), (11, SERVO, 10, 99.0), (11, SERVO, 10, 2001.0), (11, SERVO, 3, 6.4)],
)  # fmt: skip
def test_a_register_out_of_range_ends_the_program(number, floats, register, bad):
    program, _ = script()
    program.take(command(number, *changed(floats, register, bad)))
    assert not program.is_running
    assert cycles(program._motion, 10) == (0.0, 0.0)


def test_zeros_for_lookahead_and_gain_are_the_defaults_of_urscript():
    """0.1 s and 300."""
    moved = []
    for floats in (SERVO, (*SERVO[:9], 0.0, 0.0)):
        program, _ = script()
        program.take(command(11, *floats))
        moved.append(cycles(program._motion, 20))
    assert moved[0] == moved[1]


@pytest.fixture
def dashboard():
    """Return the server, and a way to serve a client of its dashboard port until it answers."""
    host = "127.0.0.1"
    ports = free_ports(host, "dashboard")
    server = UniversalRobotsServer(ServoJSettings(), H, lambda _: None)
    server.open(host, ports)
    yield server, (host, ports["dashboard"])
    server.close()


def lines_of(server, client, count):
    """Serve until the client has this many lines, or its connection is closed."""
    client.settimeout(0.01)
    data, deadline_s = b"", time.monotonic() + HANG_S
    while data.count(b"\n") < count and time.monotonic() < deadline_s:
        server.serve(0.01)
        with suppress(TimeoutError):
            more = client.recv(1 << 16)
            if not more:
                break
            data += more
    return data.decode().splitlines()


def test_a_client_that_is_gone_before_its_greeting_does_not_end_the_server(dashboard):
    """It resets the connection, by SO_LINGER of 0 s, before the server accepts it."""
    server, address = dashboard
    with socket.create_connection(address) as gone:
        gone.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    for _ in range(5):
        server.serve(0.01)
    with socket.create_connection(address) as client:
        assert lines_of(server, client, 1) == ["Connected: Universal Robots Dashboard Server"]


def test_a_dashboard_line_in_two_segments_is_one_and_quit_disconnects(dashboard):
    server, address = dashboard
    with socket.create_connection(address) as client:
        lines_of(server, client, 1)
        client.sendall(b"robot")
        for _ in range(5):
            server.serve(0.01)
        client.sendall(b"mode\nquit\nrunning\n")
        assert lines_of(server, client, 3) == ["Robotmode: RUNNING", "Disconnected"]
        assert client.recv(1) == b""


def test_packages_of_a_client_that_left_before_them_are_not_taken():
    """To pause (P) is answered; the data (U) behind it go to the first recipe of inputs."""
    is_open, taken = [True], []
    rtde = RtdeClient(lambda _: is_open[0], taken.append)
    name = b"input_int_register_0"
    rtde.receive(struct.pack(">HB", 3 + len(name), ord("I")) + name)
    data = struct.pack(">HBBi", 8, ord("U"), 1, 7)
    rtde.receive(data)
    assert taken == [{"input_int_register_0": 7}]
    is_open[0] = False
    rtde.receive(struct.pack(">HB", 3, ord("P")) + data)
    assert len(taken) == 1


def test_an_output_frequency_that_is_no_number_is_refused():
    rtde = RtdeClient(lambda _: None, lambda _: None)
    payload = struct.pack(">d", np.nan) + b"timestamp"
    with pytest.raises(ValueError, match="an output frequency of nan Hz: must be finite"):
        rtde.receive(struct.pack(">HB", 3 + len(payload), ord("O")) + payload)


def test_what_is_not_emulated_is_said():
    program, said = script()
    program.take(command(1, *6 * [0.0]))
    assert said == ["command 1 is not emulated, and does nothing"]
    assert "could not understand" in answer("load x.urp", program)
    assert answer("stop", program) == "Stopped"
    assert not program.is_running


@contextmanager
def robot(host, **ports):
    """A UR5e in real time; its server and its rig."""
    with served.robot(
        UniversalRobotsServer, "ur5e_motors", "servoj", ports or UniversalRobotsServer.ports,
        "controller.law=streaming", host=host,
    ) as found:  # fmt: skip
        yield found


class Client:
    """RTDE by hand, after the guide."""

    def __init__(self, host, port):
        self._socket = socket.create_connection((host, port), timeout=HANG_S)

    def send(self, kind, payload=b""):
        self._socket.sendall(struct.pack(">HB", 3 + len(payload), ord(kind)) + payload)

    def receive(self):
        size, kind = struct.unpack(">HB", self._read(3))
        return chr(kind), self._read(size - 3)

    def ask(self, kind, payload=b""):
        self.send(kind, payload)
        while (answer := self.receive())[0] != kind:
            pass
        return answer[1]

    def _read(self, size):
        data = b""
        while len(data) < size:
            more = self._socket.recv(size - len(data))
            assert more, "closed"
            data += more
        return data


def free_ports(host, *names):
    found = {}
    for name in names:
        with socket.create_server((host, 0)) as free:
            found[name] = free.getsockname()[1]
    return found


def test_a_client_by_hand_is_answered_and_moves_a_joint():
    host = "127.0.0.1"
    ports = free_ports(host, "rtde", "script")
    with robot(host, **ports):
        client = Client(host, ports["rtde"])
        assert client.ask("V", struct.pack(">H", 2)) == b"\x01"
        assert struct.unpack(">4I", client.ask("v"))[0] == 5
        assert client.ask("O", struct.pack(">d", 500.0) + b"actual_q,no_such")[1:] == (
            b"VECTOR6D,NOT_FOUND"
        )
        names = b"timestamp,actual_q,output_int_register_0"
        recipe = client.ask("O", struct.pack(">d", 500.0) + names)
        assert recipe[1:] == b"DOUBLE,VECTOR6D,INT32"
        inputs = ",".join(
            ["input_int_register_0", *(f"input_double_register_{k}" for k in range(11))]
        )
        number = client.ask("I", inputs.encode())[0]
        assert client.ask("S") == b"\x01"
        with socket.create_connection((host, ports["script"])) as script_port:
            script_port.sendall(b"def rtde_control():\n  sync()\nend\nrun program\n")
            while struct.unpack(">B7di", client.receive()[1])[-1] != 1:
                pass
        *start, _ = struct.unpack(">B7di", client.receive()[1])[2:]
        wanted = [*start[:5], start[5] + 0.1]
        client.send("U", struct.pack(">Bi11d", number, 11, *wanted, 0, 0, 0.002, 0.1, 300))
        deadline_s = time.monotonic() + HANG_S
        while abs(struct.unpack(">B7di", client.receive()[1])[7] - wanted[5]) > 1e-3:
            assert time.monotonic() < deadline_s


UR_RTDE = """
import sys, time, rtde_receive, rtde_control
receive = rtde_receive.RTDEReceiveInterface(sys.argv[1])
control = rtde_control.RTDEControlInterface(sys.argv[1])
wanted = receive.getActualQ()
wanted[5] += 0.1
while abs(receive.getActualQ()[5] - wanted[5]) > 1e-3:
    assert control.servoJ(wanted, 0, 0, 0.002, 0.05, 600)
    time.sleep(0.01)
assert control.servoStop()
assert control.setWatchdog(5.0)
assert control.speedJ([0, 0, 0, 0, 0, 0.1], 2.0, 0.0)
while control.isProgramRunning() or abs(receive.getActualQd()[5]) > 1e-3:
    time.sleep(0.01)
print("all done")
"""


@pytest.mark.skipif(
    find_spec("rtde_control") is None, reason="ur-rtde is not installed: no wheels from 3.13 on"
)
def test_ur_rtde_unmodified_servos_a_joint_and_a_watchdog_stops_it():
    """It waits without letting go of Python's lock, so that it needs a process of its own."""
    host = "127.0.0.57"
    with robot(host) as (server, _):
        command = [sys.executable, "-c", UR_RTDE, host]
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=HANG_S, check=False
        )  # fmt: skip
        assert done.stdout.endswith("all done\n"), done.stderr
        assert [stop["reason"] for stop in server.counts["stops"]] == [
            "watchdog: no input for 200 ms"
        ]
        # by which its lag is judged
        assert server.client_settings == {"lookahead_time_s": 0.05, "gain": 600.0}

"""`funnel-hil drives`: as a process, on a bus that any other process can join."""

import signal
import socket
from contextlib import closing

import canopen
import pytest

from bus_schema.can.frame import CanFrame
from bus_schema.can.protocol import PROTOCOLS
from bus_schema.can.session import open_can_bus
from bus_schema.can.survey import ask_drives
from bus_schema.link.can_configuration import CanConfiguration
from bus_schema.runtime.clock import MonotonicClock
from deploy.cli.drives import BusMonitor
from deploy.scenario.scenario import load_setup
from plant_emulator.drives.commissioning import build_bank
from tests.plant_emulator.drives.test_clients import patient_node
from tests.waiting import HANG_S, await_true
from tests.warm_process import WarmProcess, output_of

GROUP = "239.74.163.9"


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        return probe.getsockname()[1]


def on_bus(port):
    return [
        "--set", "link.can.interface=udp_multicast", "--set", f"link.can.channel={GROUP}",
        "--set", f"link.can.port={port}", "--set", "rate_hz=250",
    ]  # fmt: skip


def bus_of(place):
    return open_can_bus(load_setup("paper_arm", place[1::2]).scenario.link.can)


def started(*options):
    return WarmProcess("drives", "paper_arm", *options)


def test_client_in_another_process_controls_them():
    port = free_port()
    process = started(*on_bus(port), "--verbose")
    network = canopen.Network()
    network.connect(interface="udp_multicast", channel=GROUP, port=port)
    try:
        node = patient_node(2)
        network.add_node(node)
        node.nmt.wait_for_heartbeat(HANG_S)  # they may have booted before anybody listened
        node.setup_402_state_machine()
        for pdo in node.rpdo.values():
            if pdo.enabled:  # a multicast group echoes: canopen would take its own for periodic
                network.unsubscribe(pdo.cob_id)
        node.nmt.state = "OPERATIONAL"
        node.op_mode = "CYCLIC SYNCHRONOUS TORQUE"
        node.state = "OPERATION ENABLED"
    finally:
        network.disconnect()
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate()
    assert process.returncode == 0, output  # without --duration this is how it ends
    for words in (
        "cia402 drives 1, 2, 3 on udp_multicast",
        "node 2 heartbeat INITIALISING",
        "NMT START node 2",
        "node 2 SDO upload request 0x6502:00 Supported drive modes",
        "node 2 RPDO Controlword 0x000F, Target torque 0",
        "node 2: OPERATION_ENABLED",
        "frames received",
    ):
        assert words in output, words


def test_other_drives_on_the_bus_are_refused():
    place = on_bus(free_port())
    first = started(*place)
    try:
        with closing(bus_of(place)) as bus:
            protocol = PROTOCOLS["cia402"]()
            await_true(lambda: ask_drives(bus, protocol, CanConfiguration(), (1, 2, 3)))
        second = started(*place, "--duration", "1")
        output, _ = second.communicate()
        assert second.returncode == 2, output
        assert "drives with addresses 1, 2, 3 answer on this bus" in " ".join(output.split())
    finally:
        first.send_signal(signal.SIGINT)
        first.communicate()


@pytest.mark.parametrize("duration", ["inf", "nan"])
def test_a_duration_that_is_not_finite_is_refused(duration):
    output = " ".join(output_of("drives", "--duration", duration, code=2).split())
    assert "'--duration': " in output


def test_command_ends_after_its_duration_and_a_requested_fault():
    process = started(
        *on_bus(free_port()), "--duration", "0.3", "--set", "link.can.protocol=cansimple",
        "--fault", "over-temperature:2@100ms",
    )  # fmt: skip
    output, _ = process.communicate()
    assert process.returncode == 0, output
    assert "over-temperature injected at node 2" in output
    assert "node 2: IDLE, MOTOR_OVER_TEMP" in output


class ScanningBus:
    """A bus with a scan for all nodes."""

    def __init__(self):
        self._nodes = iter(range(1, 128))

    def receive(self, timeout_s):
        return CanFrame(0x600 + next(self._nodes), b"\x40\x00\x10\x00\0\0\0\0")


def test_a_scan_for_nodes_does_not_flood_the_terminal(capsys):
    setup = load_setup("paper_arm")
    can, robot = setup.scenario.link.can, setup.robot
    monitor = BusMonitor(ScanningBus(), MonotonicClock(), verbose=False)
    monitor.describe = build_bank(can, robot, setup.scenario.plant, monitor.send).describe
    for _ in range(127):
        monitor.receive(0.0)
    output = capsys.readouterr().out.splitlines()
    assert len(output) == 21
    assert "SDO upload request 0x1000" in output[0]
    assert "--verbose" in output[-1]

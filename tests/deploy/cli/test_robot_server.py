"""`robot-server`: what it refuses, and the files that it leaves."""

import json
import signal
import socket

import pytest

from deploy.cli.robot_server import Place, _listening, network_of
from deploy.run.exit_codes import INTERRUPTED
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError
from plant_emulator.robot_servers.universal_robots.server import UniversalRobotsServer
from tests.waiting import await_true
from tests.warm_process import WarmProcess, output_of


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["paper_arm"], "has 3 driven joints: must have 6 for --interface servoj"),
        (["ur5e", "--interface", "rsi"], "--interface rsi: must be 'servoj', 'speedj' or 'egm'"),
        (["ur5e_motors", "--client", "127.0.0.1"], "must be left out with --interface servoj"),
        (["ur5e_motors", "--interface", "egm", "--client", ":x"], "must be HOST or HOST:PORT"),
        (["ur5e", "--interface", "servo_j"], "--interface servo_j: must be one of torque, servoj"),
        (["ur5e_motors", "--network", "nowhere.csv"], "nowhere.csv"),
    ],
)
def test_what_it_cannot_serve_is_refused(words, message):
    assert message in " ".join(output_of("robot-server", *words, code=2).split())


def test_it_leaves_its_motion_and_counts(tmp_path):
    words = ("--host", "127.0.0.59", "--duration", "0.05", "--network", "wired_lan")
    output = output_of("robot-server", "ur5e_motors", *words, "--out", tmp_path / "out")
    assert "ur5e_motors listens at 127.0.0.59: rtde 30004" in output
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["ticks"] >= 50
    assert summary["completed"]
    assert (summary["commands"], summary["stops"], summary["lag_ms"]) == ({}, [], 6 * [None])
    assert summary["network"]["uplink"]["sent"] == 0
    first, *rows = (tmp_path / "out" / "motion.csv").read_text().splitlines()
    assert len(rows) == summary["ticks"] - summary["skipped"]
    assert float(rows[-1].split(",")[0]) == pytest.approx(summary["duration_s"])
    heads = first.split(",")
    assert heads[:2] == ["time_s", "shoulder_pan_joint.position_rad"]
    assert len(heads) == 13


def test_no_tick_leaves_files_without_rows(tmp_path):
    """1 ms at 200 Hz."""
    words = ("--host", "127.0.0.60", "--duration", "0.001", "--set", "rate_hz=200")
    output_of("robot-server", "ur5e_motors", *words, "--out", tmp_path / "out")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert (summary["ticks"], summary["lag_ms"]) == (0, 6 * [None])
    assert len((tmp_path / "out" / "motion.csv").read_text().splitlines()) == 1


def test_an_interrupted_run_is_not_complete(tmp_path):
    words = ("--host", "127.0.0.61", "--duration", "1000", "--out", tmp_path / "out")
    process = WarmProcess("robot-server", "ur5e_motors", *words)
    await_true(lambda: "listens at" in process.output(), "it listens")
    process.send_signal(signal.SIGTERM)
    assert process.wait() == INTERRUPTED
    assert not json.loads((tmp_path / "out" / "summary.json").read_text())["completed"]


@pytest.fixture
def ur5e():
    setup = load_setup("ur5e_motors", ["plant.interface.kind=servoj", "controller.law=streaming"])
    interface = setup.scenario.plant.interface
    server = UniversalRobotsServer(interface.settings, interface.period_s, lambda _: None)
    yield server, network_of(setup)
    server.close()


def place_at(host):
    return Place(host, "127.0.0.1", UniversalRobotsServer.ports)


def test_an_error_of_the_run_is_not_reported_as_one_of_the_address(ur5e):
    with pytest.raises(BrokenPipeError), _listening(*ur5e, place_at("127.0.0.62")):
        raise BrokenPipeError


def test_a_port_that_is_taken_is_reported_with_its_address(ur5e):
    with (
        socket.create_server(("127.0.0.63", 30004)),
        pytest.raises(ScenarioError, match=r"--host 127\.0\.0\.63: "),
        _listening(*ur5e, place_at("127.0.0.63")),
    ):
        pass

"""`robot-server`: what it refuses, and the files that it leaves."""

import json
import signal
import socket
from unittest.mock import Mock

import pytest

from bus_schema.egm.messages import _TYPES
from deploy.cli.robot_server import _checked
from deploy.run.exit_codes import FINISHED, INTERRUPTED
from deploy.run.network.live_feed import FeedReceiver
from deploy.run.run_folder import RunFolder, load_run
from deploy.run.serve_robot import Place, ServedRobot, network_of, open_robot
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError
from plant_emulator.robot_servers.universal_robots.server import UniversalRobotsServer
from tests.plant_emulator.robot_servers.test_abb_robot import sensor
from tests.waiting import await_true
from tests.warm_process import WarmProcess, output_of

BAD_DURATIONS = ("inf", "nan", "-inf", "86401")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["paper_arm"], "has 3 driven joints: must have 6 for --interface servoj"),
        (
            ["ur5e", "--interface", "rsi"],
            "--interface rsi: must be one of servoj, ",
        ),
        (["ur5e_motors", "--vendor", "kuka"], "--vendor kuka: must be left out, or xarm"),
        (["ur5e_motors", "--interface", "egm", "--vendor", "xarm"], "must be servoj with --vendor"),
        (["paper_arm", "--vendor", "xarm"], "must have 5 or 6 or 7 for --interface xarm"),
        (["ur5e_motors", "--interface", "franka_torque"], "must have 7 for --interface franka_"),
        (["ur5e_motors", "--client", "127.0.0.1"], "must be left out with --interface servoj"),
        (["ur5e_motors", "--interface", "egm", "--client", "192.0.2.1"], "--client 192.0.2.1: "),
        (["ur5e_motors", "--interface", "egm", "--client", ":x"], "must be HOST or HOST:PORT"),
        (["ur5e_motors", "--interface", "egm", "--client", "a..b"], "--client a..b: "),
        (["ur5e_motors", "--host", "a..b"], "--host a..b: "),
        *((["ur5e_motors", "--duration", bad], "'--duration': ") for bad in BAD_DURATIONS),
        (["ur5e", "--interface", "servo_j"], "--interface servo_j: must be one of torque, servoj"),
        (["ur5e_motors", "--network", "nowhere.csv"], "nowhere.csv"),
    ],
)
def test_what_it_cannot_serve_is_refused_and_leaves_nothing(words, message, tmp_path):
    out = ("--out", tmp_path / "out")
    assert message in " ".join(output_of("robot-server", *words, *out, code=2).split())
    assert not (tmp_path / "out").exists()


def test_it_leaves_the_files_of_a_run_and_counts(tmp_path):
    words = ("--host", "127.0.0.59", "--duration", "0.05", "--network", "wired_lan")
    output = output_of("robot-server", "ur5e_motors", *words, "--out", tmp_path / "out")
    assert "ur5e_motors listens at 127.0.0.59: rtde 30004" in output
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["ticks"] >= 50
    assert summary["completed"]
    assert (summary["robot_server"]["commands"], summary["robot_server"]["stops"]) == ({}, [])
    assert (summary["lag_ms"], summary["verdict"]) == (6 * [None], "nothing")
    assert summary["transport"]["uplink"]["sent"] == 0
    names = {each.name for each in (tmp_path / "out").iterdir()}
    assert {"run.mcap", "report.html", "manifest.json", "scenario.yaml"} <= names


def test_no_tick_leaves_a_summary(tmp_path):
    """1 ms at 200 Hz."""
    words = ("--host", "127.0.0.60", "--duration", "0.001", "--set", "rate_hz=200")
    output_of("robot-server", "ur5e_motors", *words, "--out", tmp_path / "out")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert (summary["ticks"], summary["lag_ms"]) == (0, 6 * [None])
    assert summary["verdict"] == "nothing"


def test_an_interrupted_run_is_not_complete(tmp_path):
    words = ("--host", "127.0.0.61", "--duration", "1000", "--out", tmp_path / "out")
    process = WarmProcess("robot-server", "ur5e_motors", *words)
    await_true(lambda: "listens at" in process.output(), "it listens")
    process.send_signal(signal.SIGTERM)
    assert process.wait() == INTERRUPTED
    assert not json.loads((tmp_path / "out" / "summary.json").read_text())["completed"]


@pytest.mark.parametrize("error", ["too large", "no room"])
def test_a_run_that_its_reference_cannot_judge_has_a_whole_recording(tmp_path, monkeypatch, error):
    """The file of what the client asked for is larger than is read, or cannot be written."""
    if error == "too large":
        monkeypatch.setattr("bus_schema.tables.MOST_BYTES", 100)
    else:
        full = OSError(28, "No space left on device")
        monkeypatch.setattr("deploy.run.asked_motion.np.savetxt", Mock(side_effect=full))
    setup, server = _checked("ur5e_motors", "servoj", None, None, None)
    said, place = [], Place("127.0.0.58", "127.0.0.1", server.ports)
    robot = ServedRobot(setup, server, "servoj", place, said.append)
    with robot.opened(), RunFolder.begin(setup, tmp_path / "out", overwrite=False) as folder:
        run = robot.run(folder, 50)
    data, contents = load_run(folder.path)
    assert contents.complete
    assert data.damage == []
    assert len(contents.payloads["joint_states"]) == 51
    [fault] = run.summary["faults"]
    assert f"what the client asked for cannot judge the run in {folder.path}: " in fault
    assert ("larger than" in fault) or ("No space left" in fault)
    assert run.verdict == "faulted"
    assert fault.partition("s: ")[2] in " ".join(said)


def test_the_longest_duration_ends_a_run_without_one(tmp_path, monkeypatch):
    monkeypatch.setattr("deploy.run.serve_robot.LONGEST_S", 0.05)
    setup, server = _checked("ur5e_motors", "servoj", None, None, None)
    place = Place("127.0.0.57", "127.0.0.1", server.ports)
    robot = ServedRobot(setup, server, "servoj", place, lambda _: None)
    with robot.opened(), RunFolder.begin(setup, tmp_path / "out", overwrite=False) as folder:
        summary = robot.run(folder, None).summary
    assert (summary["ticks"], summary["completed"]) == (50, True)


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
    with pytest.raises(BrokenPipeError), open_robot(*ur5e, place_at("127.0.0.62")):
        raise BrokenPipeError


def test_a_port_that_is_taken_is_reported_with_its_address(ur5e):
    with (
        socket.create_server(("127.0.0.63", 30004)),
        pytest.raises(ScenarioError, match=r"--host 127\.0\.0\.63: "),
        open_robot(*ur5e, place_at("127.0.0.63")),
    ):
        pass


def served_by(tmp_path, talk, *words):
    """Serve a UR5e under EGM to a client by hand; the summary of its run."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.bind(("127.0.0.1", 0))
        client.settimeout(30.0)
        place = f"127.0.0.1:{client.getsockname()[1]}"
        egm = ("--interface", "egm", "--client", place)
        process = WarmProcess(
            "robot-server", "ur5e_motors", *egm, *words, "--out", tmp_path / "out", "--no-report"
        )
        talk(client)
        process.send_signal(signal.SIGTERM)
        assert process.wait() == FINISHED
    return json.loads((tmp_path / "out" / "summary.json").read_text())


def ramp(client, cycles, speed_deg_s=5.0, start=None):
    """Answer states with positions of a ramp, as of their time, from where the arm was."""
    for _ in range(cycles):
        data, robot = client.recvfrom(1 << 16)
        state = _TYPES["EgmRobot"].FromString(data)
        begun_ms, home = start or (state.header.tm, list(state.feedBack.joints.joints))
        start = begun_ms, home
        moved = speed_deg_s * 1e-3 * (state.header.tm - begun_ms)
        client.sendto(sensor([each + moved for each in home]), robot)
    return start


def test_a_run_has_the_lag_and_the_verdict_of_what_its_client_asked_for(tmp_path):
    """Behind a ramp, the lag of a gain of 20/s is 1/20 s."""
    summary = served_by(tmp_path, lambda client: ramp(client, 250))
    assert summary["lag_ms"] == pytest.approx(6 * [50.0], abs=8.0)
    assert summary["bounds"]["violation_fraction"] == 0.0
    assert summary["law"] == "the robot's client"
    assert summary["faults"] == []
    assert summary["verdict"] == "kept"
    assert (first_s := summary["robot_server"]["first_target_s"]) > 0.0
    assert first_s < summary["robot_server"]["last_target_s"] <= summary["duration_s"]
    scenario = load_setup(str(tmp_path / "out" / "scenario.yaml")).scenario
    assert scenario.metrics.from_s == first_s  # the arm rested before, which is no error
    refused = output_of("replay", tmp_path / "out", code=2)
    assert "the robot's client: is not a law that funnel-hil can replay" in refused
    again = output_of("report", tmp_path / "out", code=0)
    assert "the robot's client" in again
    assert f"The client gave targets from {first_s:.3f} to " in " ".join(again.split())
    assert (
        json.loads((tmp_path / "out" / "summary.json").read_text())["lag_ms"] == (summary["lag_ms"])
    )


def test_a_stop_while_the_client_goes_on_is_a_fault_with_name_and_time(tmp_path):
    """The time-out is 200 ms; the client pauses for longer, then sends again."""

    def talk(client):
        start = ramp(client, 20)
        for _ in range(90):
            client.recvfrom(1 << 16)
        ramp(client, 20, start=start)

    summary = served_by(tmp_path, talk)
    [stop] = summary["robot_server"]["stops"]
    assert stop["is_fault"]
    assert stop["reason"] == "egm_communication_timeout: no correction for 200 ms"
    assert summary["verdict"] == "faulted"
    assert summary["faults"] == [
        f"plant at {stop['time_s']:.3f} s: the robot stopped: {stop['reason']}"
    ]


def test_a_viewer_sees_the_run(tmp_path):
    seen = []

    def talk(client):
        scenario = await_true(lambda: next((tmp_path / "out").glob("scenario.yaml"), None))
        endpoint = load_setup(str(scenario)).scenario.link.plant_endpoint
        receiver = FeedReceiver(endpoint)

        def look():
            ramp(client, 2)
            snapshot = receiver.receive(0.05)
            seen.extend(() if snapshot is None else [m.topic.name for m in snapshot.messages])
            return {"joint_states", "plant_truth"} <= set(seen)

        await_true(look)
        receiver.close()

    served_by(tmp_path, talk)

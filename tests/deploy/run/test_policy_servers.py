"""Runs whose law is a policy server, as LeRobot's service and openpi's websocket have them."""

from __future__ import annotations

import socket
import threading
import time

import numpy as np
import pytest

from bus_schema.configuration import ConfigurationError
from bus_schema.recording.mcap_log import read_log
from deploy.judge.metrics import summarise
from deploy.run.execute import InProcesses, execute, lockstep_setup
from deploy.run.replay import replay
from deploy.run.run_folder import RunFolder
from deploy.run.simulate import simulate
from deploy.scenario.yaml_files import ScenarioError
from tests.controller.policies.servers import LeRobotLikeServer, OpenPiLikeServer, field
from tests.one_joint import policy_setup

pytest.importorskip("grpc", reason="needs the extra policies")
msgpack = pytest.importorskip("msgpack", reason="needs the extra policies")
pytest.importorskip("websockets", reason="needs the extra policies")

ZENOH = "link.kind=zenoh"
ROWS, PERIOD_S, NEAR_0 = 16, 0.04, pytest.approx(0.0, abs=1e-12)
STATE = "controller.policy_server.state=[position, reference_position, reference_velocity]"
LEROBOT = "controller.policy_server.lerobot={policy_type: act, checkpoint: somewhere}"


def setup_of(folder, address, *overrides, **more):
    return policy_setup(
        folder, "controller.gains={}", f"controller.law={address}", STATE, LEROBOT,
        "controller.between_answers=linear",
        "controller.chunks={horizon: 16, period_ms: 40, ask_every: 6}",
        "controller.policy_server.timeout_s=2", "controller.policy_server.start_timeout_s=2",
        "duration_s=3", *overrides, funnel_rad=0.05, **more,
    )  # fmt: skip


def along_the_wave(reference, velocity):
    """The next positions along -0.5 cos(t), from its position and velocity at one time."""
    begin_s = np.arctan2(velocity, -reference)
    return -0.5 * np.cos(begin_s + PERIOD_S * np.arange(ROWS))[:, np.newaxis]


def of_lerobot(observation):
    values = observation.observation
    return along_the_wave(values["j0.reference_position"], values["j0.reference_velocity"])


def of_openpi(observation):
    _, reference, velocity = observation["observation/state"]
    return {"actions": along_the_wave(reference, velocity)}


@pytest.fixture
def start():
    started = []

    def begin(kind, *args, **more):
        started.append(kind(*args, **more))
        return started[-1]

    yield begin
    for each in started:
        each.stop()


def openpi_code():
    """openpi-client's own packing; it asks for NumPy below 2, so install it with --no-deps."""
    return pytest.importorskip("openpi_client.msgpack_numpy", reason="needs openpi-client 0.1.2")


def of_kind(start, kind):
    if kind == "lerobot":
        return start(LeRobotLikeServer, of_lerobot)
    code = openpi_code()
    return start(OpenPiLikeServer, of_openpi, code.packb, code.unpackb)


@pytest.mark.parametrize("kind", ["lerobot", "openpi"])
def test_policy_behind_a_server_keeps_the_bounds(tmp_path, start, kind):
    server = of_kind(start, kind)
    run = simulate(setup_of(tmp_path, server.address, "controller.inference_ms=100"))
    found = summarise(run.data())
    assert found["verdict"] == "kept", run.failure
    assert found["chunks"]["switches"] == pytest.approx(3.0 / (6 * PERIOD_S), abs=1)
    assert found["chunks"]["age_ms"]["largest"] == pytest.approx(100 + 6 * 40, abs=1)


def test_lerobot_server_receives_what_it_needs(tmp_path, start):
    server = start(LeRobotLikeServer, of_lerobot)
    more = "controller.policy_server.images={front: [4, 6]}", "controller.policy_server.task=reach"
    simulate(setup_of(tmp_path, server.address, "duration_s=0.5", *more))
    setup = vars(server.setup)
    assert (setup["policy_type"], setup["pretrained_name_or_path"]) == ("act", "somewhere")
    assert (setup["actions_per_chunk"], setup["device"]) == (ROWS, "cpu")
    names = ["j0.pos", "j0.reference_position", "j0.reference_velocity"]
    assert setup["lerobot_features"]["observation.state"]["names"] == names
    assert setup["lerobot_features"]["observation.images.front"]["shape"] == (4, 6, 3)
    first = server.seen[0].observation
    assert (first["j0.reference_position"], first["j0.reference_velocity"]) == (-0.5, NEAR_0)
    assert (first["front"].shape, first["task"]) == ((4, 6, 3), "reach")
    assert all(each.must_go for each in server.seen)
    assert server.readies == 1


def test_long_observations_come_in_parts(tmp_path, start):
    """An image of 4.7 MB in messages of at most 2 MB: begin 1, middle 2, end 3."""
    server = start(LeRobotLikeServer, of_lerobot)
    image = "controller.policy_server.images={front: [1024, 1536]}"
    run = simulate(setup_of(tmp_path, server.address, "duration_s=0.1", image))
    assert run.failure is None
    assert (server.states[0], set(server.states[1:-1]), server.states[-1]) == (1, {2}, 3)
    assert (server.seen[0].observation["front"] == 128).all()


def test_degrees_are_converted_both_ways(tmp_path, start):
    seen = []

    def in_degrees(observation):
        reference, velocity = np.deg2rad(observation["observation/state"][1:])
        seen.append(reference)
        return {"actions": np.rad2deg(along_the_wave(reference, velocity))}

    code = openpi_code()
    server = start(OpenPiLikeServer, in_degrees, code.packb, code.unpackb)
    run = simulate(setup_of(tmp_path, server.address, "controller.policy_server.unit=deg"))
    assert summarise(run.data())["verdict"] == "kept"
    assert seen[0] == pytest.approx(-0.5, rel=1e-6)


def test_replay_needs_no_server(tmp_path, start):
    server = start(LeRobotLikeServer, of_lerobot)
    setup = setup_of(tmp_path, server.address, "controller.inference_ms=100")
    first = simulate(setup)
    again = simulate(setup)
    assert first.data().digest == again.data().digest
    first.write_log(tmp_path / "run.mcap")
    server.stop()
    result = replay(setup, read_log(tmp_path / "run.mcap"))
    assert result.is_identical, result.failure


def test_measured_inference_time_is_the_delay_and_is_replayed(tmp_path, start):
    """Each answer takes 60 ms or more of wall time: no younger answer may act."""

    def slowly(observation):
        time.sleep(0.06)
        return of_lerobot(observation)

    server = start(LeRobotLikeServer, slowly)
    measured = "controller.policy_server.inference=measured"
    setup = setup_of(tmp_path, server.address, measured)
    run = simulate(setup)
    switches = summarise(run.data())["chunks"]
    assert switches["age_ms"]["largest"] >= 6 * 40 + 60
    run.write_log(tmp_path / "run.mcap")
    server.stop()
    result = replay(setup, read_log(tmp_path / "run.mcap"))
    assert result.is_identical, result.failure


def run_and_replay(setup, folder):
    """Run in processes, and return the run and its replay."""
    files = RunFolder.begin(setup, folder)
    outcome = execute(setup, InProcesses(), files)
    return outcome, replay(setup, read_log(files.log))


def test_lockstep_gives_the_digest_of_simulate(tmp_path, start):
    server = start(LeRobotLikeServer, of_lerobot)
    setup = setup_of(tmp_path, server.address, "controller.inference_ms=100", "duration_s=1", ZENOH)
    expected = simulate(setup).data().digest
    assert execute(lockstep_setup(setup), InProcesses()).summary["digest"] == expected


def test_loop_goes_on_in_real_time_and_is_replayed(tmp_path, start):
    """The server takes 150 ms: with a loop that waited, no state would come in between."""

    def slowly(observation):
        time.sleep(0.15)
        return of_lerobot(observation)

    server = start(LeRobotLikeServer, slowly)
    setup = setup_of(tmp_path, server.address, "clock=realtime", ZENOH)
    outcome, result = run_and_replay(setup, tmp_path / "run")
    ages = outcome.summary["chunks"]["age_ms"]
    assert ages["largest"] >= 6 * 40 + 150
    server.stop()
    assert result.is_identical, result.failure


def test_server_that_fails_in_real_time_stops_the_run(tmp_path, start):
    server = start(LeRobotLikeServer, after(3, b""))
    setup = setup_of(tmp_path, server.address, "clock=realtime", ZENOH)
    outcome = execute(setup, InProcesses())
    assert outcome.summary["verdict"] == "faulted"
    assert any("answered without actions" in event.detail for event in outcome.data.events)


def failure_of(folder, address, *overrides):
    run = simulate(setup_of(folder, address, *overrides))
    assert summarise(run.data())["verdict"] in ("faulted", "nothing")
    return str(run.failure)


def after(count, bad):
    """Answer well so many times, then with something else."""
    asked = []

    def answer(observation):
        asked.append(observation)
        if len(asked) <= count:
            return of_lerobot(observation)
        return bad(observation) if callable(bad) else bad

    return answer


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (np.zeros((ROWS, 2)), r"shape \(16, 2\): must be \(actions, 1\)"),
        (np.zeros((5, 1)), "an answer has 5 rows: must be 16"),
        (np.full((ROWS, 1), np.nan), "action 0 has nan for joint 1: must be finite"),
        (b"", "answered without actions"),
        (b"\x0a\x7f\x01", "no message Actions"),
        (field(b"garbage"), "cannot be read"),
        (lambda _: time.sleep(3), "did not answer GetActions within 2 s"),
        (lambda _: 1 / 0, "GetActions failed with UNKNOWN"),
    ],
)
def test_bad_answers_of_lerobot_stop_the_run(tmp_path, start, bad, message):
    server = start(LeRobotLikeServer, after(3, bad))
    found = failure_of(tmp_path, server.address)
    assert "lerobot://127.0.0.1" in found
    assert message.replace("\\", "") in found


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ("Traceback …\nValueError: no GPU", "it reports an error: ValueError: no GPU"),
        (b"\xc1", "cannot be read"),
        ({"action": 1.0}, "has no actions, but action"),
        ({"actions": [["a"]]}, "the actions are no numbers"),
        ({"actions": np.full((ROWS, 1), np.inf)}, "must be finite"),
    ],
)
def test_bad_answers_of_openpi_stop_the_run(tmp_path, start, bad, message):
    code = openpi_code()
    server = start(OpenPiLikeServer, lambda _: bad, code.packb, code.unpackb)
    assert message in failure_of(tmp_path, server.address)


def free_port():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return taken.getsockname()[1]


@pytest.mark.parametrize("kind", ["lerobot", "openpi"])
def test_server_that_is_not_there_is_named(tmp_path, kind):
    address = f"{kind}://127.0.0.1:{free_port()}"
    found = failure_of(tmp_path, address, "controller.policy_server.start_timeout_s=0.5")
    assert f"policy server {address}: is not reachable" in found


def test_restarted_server_gets_its_policy_again(tmp_path, start):
    servers = [start(LeRobotLikeServer, of_lerobot)]

    def restart_at_the_fifth(observation):
        if len(servers[0].seen) == 5:
            servers[0].stop()
            servers.append(start(LeRobotLikeServer, of_lerobot, servers[0].port))
        return of_lerobot(observation)

    servers[0].answer = restart_at_the_fifth
    address = servers[0].address
    setup = setup_of(tmp_path, address)
    run = simulate(setup)
    assert run.failure is None
    assert servers[1].readies == 1
    assert servers[1].setup.policy_type == "act"


def test_lost_websocket_is_opened_again(tmp_path, start):
    code, asked = openpi_code(), []

    def drop_once(observation):
        asked.append(observation)
        return None if len(asked) == 5 else of_openpi(observation)

    server = start(OpenPiLikeServer, drop_once, code.packb, code.unpackb)
    run = simulate(setup_of(tmp_path, server.address))
    assert (run.failure, server.connections) == (None, 2)


def test_server_that_dies_for_good_stops_the_run(tmp_path, start):
    code, asked = openpi_code(), []

    def die(observation):
        asked.append(observation)
        if len(asked) >= 5:
            threading.Thread(target=server.stop).start()  # it waits for its connections
            return None
        return of_openpi(observation)

    server = start(OpenPiLikeServer, die, code.packb, code.unpackb)
    assert "is not reachable" in failure_of(tmp_path, server.address)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("controller.law=lerobot://nowhere", "policy server as lerobot://host:port"),
        ("controller.law=lerobot://host:0", "policy server as lerobot://host:port"),
        ("controller.chunks={horizon: 16}", "must have horizon, the actions of an answer"),
        ("controller.policy_server.lerobot=null", "must have policy_type and checkpoint"),
        ("controller.policy_server.state=[]", "controller.policy_server.state"),
        ("controller.policy_server.state=[torque]", "controller.policy_server.state"),
        ("controller.policy_server.timeout_s=0", "controller.policy_server.timeout_s"),
        ("controller.drive_feedback.enabled=false", "must not be a policy server, unless"),
    ],
)
def test_bad_input_is_refused_before_anything_connects(tmp_path, override, message):
    with pytest.raises((ScenarioError, ConfigurationError), match=message):
        setup_of(tmp_path, "lerobot://127.0.0.1:9", override)

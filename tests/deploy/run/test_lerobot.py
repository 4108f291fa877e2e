"""LeRobot's own policy server, unmodified, with a policy of LeRobot trained here.

It needs PyTorch, so it runs in an environment of its own: set FUNNEL_HIL_LEROBOT_PYTHON to the
Python of one that has lerobot 0.4.4.
"""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from bus_schema.recording.mcap_log import read_log
from deploy.judge.metrics import summarise
from deploy.run.replay import replay
from deploy.run.simulate import simulate
from tests.deploy.run.test_policy_servers import free_port, run_and_replay, setup_of

PYTHON = os.environ.get("FUNNEL_HIL_LEROBOT_PYTHON", "")
SCRIPTS = Path(__file__).parents[2] / "controller/policies"
pytestmark = pytest.mark.skipif(
    not PYTHON, reason="needs FUNNEL_HIL_LEROBOT_PYTHON, a Python that has lerobot"
)


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    folder = tmp_path_factory.mktemp("act")
    script = [PYTHON, str(SCRIPTS / "train_act.py"), str(folder)]
    subprocess.run(script, check=True, cwd=folder, capture_output=True)
    return folder


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    port, folder = free_port(), tmp_path_factory.mktemp("server")
    options = [f"--port={port}", "--host=127.0.0.1", "--fps=25", "--inference_latency=0"]
    command = [PYTHON, "-m", "lerobot.async_inference.policy_server", *options]
    with (folder / "log").open("w") as log:
        process = subprocess.Popen(command, cwd=folder, stdout=log, stderr=log)
    yield f"lerobot://127.0.0.1:{port}"
    process.terminate()
    process.wait()


def with_policy(folder, address, checkpoint, *overrides):
    act = f"{{policy_type: act, checkpoint: {checkpoint}}}"
    return setup_of(
        folder, address, f"controller.policy_server.lerobot={act}",
        "controller.policy_server.images={front: [32, 32]}",
        "controller.policy_server.start_timeout_s=120", *overrides,
    )  # fmt: skip


def test_lerobot_server_is_in_the_loop(tmp_path, address, checkpoint):
    setup = with_policy(tmp_path, address, checkpoint, "controller.inference_ms=100")
    runs = [simulate(setup) for _ in range(2)]
    found = summarise(runs[0].data())
    assert found["verdict"] == "kept", runs[0].failure
    assert found["chunks"]["age_ms"]["largest"] == pytest.approx(340, abs=1)
    assert runs[0].data().digest == runs[1].data().digest
    runs[0].write_log(tmp_path / "run.mcap")
    result = replay(setup, read_log(tmp_path / "run.mcap"))
    assert result.is_identical, result.failure


def test_lerobot_server_is_in_the_loop_in_real_time(tmp_path, address, checkpoint):
    setup = with_policy(tmp_path, address, checkpoint, "clock=realtime", "link.kind=zenoh")
    outcome, result = run_and_replay(setup, tmp_path / "run")
    assert outcome.summary["chunks"]["switches"] >= 1
    assert result.is_identical, result.failure


def test_unknown_policy_is_refused_by_name(tmp_path, address):
    bad = "controller.policy_server.lerobot={policy_type: act2, checkpoint: nowhere}"
    run = simulate(with_policy(tmp_path, address, "nowhere", bad))
    assert "Policy type act2 not supported" in str(run.failure)


def test_missing_checkpoint_is_named(tmp_path, address):
    run = simulate(with_policy(tmp_path, address, tmp_path / "nowhere"))
    assert "SendPolicyInstructions failed with UNKNOWN" in str(run.failure)

"""The example of a flow policy with guidance, alone and against LeRobot's real-time chunking."""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from controller.chunks.answer import Answer, Holding
from controller.chunks.configuration import ChunksConfiguration
from controller.control_law import Diagnostics, Tracking
from controller.slow_law import AnswerTiming, ChunkRules, SlowLaw
from tests.deploy.docs.pages import DOCS
from tests.warm_process import WITHOUT_REPORT, WarmProcess

FOLDER = DOCS / "examples/flow-policy"
PYTHON = os.environ.get("FUNNEL_HIL_LEROBOT_PYTHON", "")
H, S, D = 16, 6, 3
FADING = np.r_[np.ones(D), np.linspace(1.0, 0.0, H - S - D + 2)[1:-1], np.zeros(S)]


@pytest.fixture(scope="module")
def flow():
    spec = importlib.util.spec_from_file_location("flow_example", FOLDER / "flow.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_samples_have_the_demonstrated_spread(flow):
    """An exact flow ends at the distribution of the chunks; ten Euler steps make it narrower."""
    policy, at = flow.Policy(SimpleNamespace(joints=6)), SimpleNamespace(time_s=1.0, error=0.0)
    off = np.array([policy.target(at)[:, 0] - flow.mean_of(1.0) for _ in range(300)])
    assert 0.8 * flow.DEVIATION_RAD < off.std() < 1.1 * flow.DEVIATION_RAD
    assert np.abs(off.mean((0, 2))).max() < 3 * flow.DEVIATION_RAD / np.sqrt(300 * 6)


def test_guided_chunk_continues_the_one_before(flow):
    """Independent chunks differ by √2 of their spread; a frozen action must be near the old one."""
    off, spread = {}, {}
    for is_guided in (False, True):
        policy, found, beside = flow.Policy(SimpleNamespace(joints=6)), [], []
        at = SimpleNamespace(time_s=0.0, error=0.0)
        old = policy.target(at)
        for _ in range(100):
            at.time_s += S * flow.PERIOD_S
            if is_guided:
                policy.guide(old[S:], FADING, D)
            new = policy.target(at)
            found.append(new[:D, 0] - old[S : S + D, 0])
            beside.append(new[:, 0] - flow.mean_of(at.time_s))
            old = new
        off[is_guided], spread[is_guided] = np.std(found), np.std(beside)
    assert off[False] == pytest.approx(np.sqrt(2.0) * spread[False], rel=0.1)
    assert off[True] < 0.1 * off[False]


def test_it_keeps_its_bounds(tmp_path):
    folder = shutil.copytree(FOLDER, tmp_path / "example")
    words = ("simulate", "scenario.yaml", "--set", "duration_s=2", "--out", folder / "out")
    process = WarmProcess(*words, cwd=folder, main=WITHOUT_REPORT)
    output, _ = process.communicate()
    assert process.returncode == 0, output
    summary = json.loads((folder / "out" / "summary.json").read_text())
    assert summary["chunks"]["switches"] == int((2.0 - 0.1) / (S * 0.04))


@pytest.fixture(scope="module")
def of_lerobot(flow, tmp_path_factory):
    """What LeRobot's own code gives for the same input, and the input."""
    if not PYTHON:
        pytest.skip("needs FUNNEL_HIL_LEROBOT_PYTHON, a Python that has lerobot")
    folder, chance = tmp_path_factory.mktemp("rtc"), np.random.default_rng(3)
    taus = np.array([0.1, 0.3, 0.5, 0.7, 0.9])
    given = {
        "taus": taus, "denoisers": np.array([flow.denoiser(tau) for tau in taus]),
        "sample": chance.standard_normal((H, 6)), "prefix": chance.standard_normal((H - S, 6)),
    }  # fmt: skip
    np.savez(folder / "in.npz", **given)
    script = Path(__file__).parents[2] / "controller/policies/lerobot_rtc.py"
    words = [PYTHON, str(script), str(folder / "in.npz"), str(folder / "out.npz")]
    subprocess.run(words, check=True, cwd=folder)
    return given, dict(np.load(folder / "out.npz"))


@pytest.mark.parametrize("kind", ["linear", "exponential"])
def test_weights_are_those_of_lerobot(of_lerobot, kind):
    chunks = ChunksConfiguration.model_validate({
        "horizon": H, "period_ms": 40, "ask_every": S, "merge": "frozen_prefix",
        "frozen_prefix": {"weights": kind},
    })  # fmt: skip
    merge = chunks.build(0.001, 0.1, np.full(1, np.inf))
    answer = Answer(0.0, 0.0, 0.04, np.zeros((1, 1)), np.zeros((H, 2, 1)), Holding())
    _, weights, delay_steps = merge.guidance(answer, 0.24)
    np.testing.assert_allclose(weights, of_lerobot[1][kind], atol=1e-6)
    assert delay_steps == D


def test_guidance_is_that_of_lerobot(flow, of_lerobot):
    """LeRobot 0.4.4 leaves out the network's Jacobian: its gradient is the identity."""
    given, found = of_lerobot
    for tau, matrix, velocity in zip(
        given["taus"], given["denoisers"], found["velocities"], strict=True
    ):
        expected = matrix @ given["sample"]
        own = (expected - given["sample"]) / (1.0 - tau)
        mine = flow.guided(own, expected, np.eye(H), given["prefix"], FADING, tau)
        np.testing.assert_allclose(mine, velocity, atol=1e-5)


def test_guidance_of_lerobot_makes_a_trained_flow_policy_continue(of_lerobot):
    """Jumps in units of 0.2 rad; the demonstrations' offset has a deviation of 0.1."""
    _, found = of_lerobot
    assert found["free"].mean() > 0.05
    assert found["guided"].mean() < 0.5 * found["free"].mean()


class Numbered:
    """Answers chunk k as 1000 k + i."""

    def __init__(self):
        self.diagnostics, self.asked = Diagnostics(1), 0

    def reset(self):
        self.asked = 0

    def torque(self, _tracking):
        return np.zeros(1)

    def target(self, _tracking):
        rows = 1000.0 * self.asked + np.arange(H)
        self.asked += 1
        return np.stack([rows, np.zeros(H)], axis=1)[:, :, np.newaxis]


def test_actions_are_those_of_the_action_queue_of_lerobot(of_lerobot):
    period_s = 0.04
    chunks = ChunksConfiguration.model_validate(
        {"horizon": H, "period_ms": 40, "ask_every": S, "merge": "replace"}
    )
    delay_s = D * period_s
    merge = chunks.build(period_s, delay_s, np.full(1, np.inf))
    timing = AnswerTiming(1, delay_s, 0.0, Holding(), period_s, 0, delay_s)
    law, tracking = SlowLaw(Numbered(), timing, ChunkRules(merge, period_s, H, 1.0, S)), Tracking(1)
    acting = []
    for tick in range(60):
        tracking.time_s, tracking.step_s = tick * period_s, period_s
        law.torque(tracking)
        acting.append(law.target(tracking)[0, 0])
    np.testing.assert_array_equal(acting, of_lerobot[1]["queued"])

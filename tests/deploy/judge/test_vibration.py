"""A torque that swings between its limits is a vibration: the run does not hold."""

from __future__ import annotations

import numpy as np
import pytest

from deploy.judge.findings.loss_reason import Reason
from deploy.judge.findings.vibration import vibrations
from deploy.judge.metrics import RunResult, summarise
from deploy.judge.run_rows import reason_of, row, tolerated
from deploy.reports.verdict_texts import verdict_on_run
from deploy.run.execute import JudgedRun
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from deploy.studies.margin.margin import Margin
from deploy.studies.margin.result import MarginResult
from deploy.studies.margin.sentences import margin_sentences
from tests.deploy.study.studies import Here, case_of, conduct
from tests.deploy.study.theory.linear_arms import ARMS, RESOLUTION_MS, RESONANT, constant, exact_ms

RATE_HZ, LIMIT_NM = 1000.0, 200.0
TIMES_S = np.arange(6000) / RATE_HZ
LIMIT = "plant.actuator.saturation_nm"
RESONANCE_HZ = np.sqrt(84220.6 * (1 / 0.1 + 1 / 0.5)) / (2.0 * np.pi)
"""Of both inertias on the gear's spring."""


def vibration_of(asked_nm):
    """What is found of a torque that an actuator clips."""
    torque = np.clip(asked_nm, -LIMIT_NM, LIMIT_NM)
    (found,) = vibrations(
        torque[:, None], np.abs(asked_nm) >= LIMIT_NM, np.array([LIMIT_NM]), RATE_HZ
    )
    return found


@pytest.mark.parametrize(("size", "rms"), [(1.02, 0.5**0.5), (1e6, 1.0)])
def test_sine_and_square_wave_have_their_rms(size, rms):
    found = vibration_of(size * LIMIT_NM * np.sin(2.0 * np.pi * 50.0 * TIMES_S + 0.3))
    assert found.frequency_hz == pytest.approx(50.0, abs=1.0)
    assert found.torque_rms_share == pytest.approx(rms, rel=0.02)


@pytest.mark.parametrize(
    "torque_nm",
    [
        0.95 * LIMIT_NM * np.sin(300.0 * TIMES_S),  # below the limits
        1.1 * LIMIT_NM * np.sin(2.0 * np.pi * 2.0 * TIMES_S),  # as slow as a motion
        np.where(TIMES_S < 2.5, 1e6 * np.sin(300.0 * TIMES_S), 10.0),  # over before the last half
        1e6 * np.ones_like(TIMES_S),  # too weak an actuator
        50.0 * np.sign(np.sin(900.0 * TIMES_S)),  # a switching law
    ],
)
def test_other_torques_are_no_vibration(torque_nm):
    assert vibration_of(torque_nm) is None


@pytest.fixture
def resonant(tmp_path):
    def run(delay_ms):
        file = ARMS[RESONANT].write(tmp_path)
        setup = load_setup(str(file), [f"{LIMIT}={LIMIT_NM}", *constant(delay_ms)])
        return simulate(setup).data()

    return run


@pytest.mark.parametrize(("delay_ms", "is_unstable"), [(1.5, False), (2.5, True), (4.0, False)])
def test_an_unstable_loop_that_its_limits_keep_within_bounds_does_not_hold(
    resonant, delay_ms, is_unstable
):
    """Windows of the exact loop: from 2.17 to 2.97 ms, and from 8.4 ms on."""
    data = resonant(delay_ms)
    summary = summarise(data)
    values = row(RunResult(**summary), 0)
    assert (summary["verdict"], values["vibrating"]) == ("kept", is_unstable)
    assert tolerated(values) is not is_unstable
    assert reason_of(values) == (Reason.VIBRATION if is_unstable else None)
    warned = any(
        "this loop vibrates" in each
        for each in verdict_on_run(JudgedRun("pid", data, RunResult(**summary))).reasons
    )
    assert warned is is_unstable
    for found in summary["vibrating"]:
        assert found["frequency_hz"] == pytest.approx(RESONANCE_HZ, rel=0.05)


def test_margin_ends_where_the_loop_vibrates(tmp_path):
    search = {
        "scenarios": [str(ARMS[RESONANT].write(tmp_path))], "set": {LIMIT: LIMIT_NM},
        "laws": ["pid"], "offsets": [1.0], "running": [False], "limit": 4,
    }  # fmt: skip
    study = Margin(search, tmp_path)
    _, folder = conduct(study, tmp_path / "out", Here())
    case, sentences = (
        case_of(study, folder),
        margin_sentences(MarginResult.model_validate(study.summary(folder.rows))),
    )
    assert case["margin"] == case["quoted"] == RESOLUTION_MS * (exact_ms(RESONANT) // RESOLUTION_MS)
    (failed,) = (each for each in case["probes"] if each["value"] == case["first_failure"])
    assert failed["losses"] == {Reason.VIBRATION: failed["runs"]}
    assert any("swings between its limits" in each for each in sentences)


@pytest.mark.parametrize(
    ("arm", "law", "delay_ms"),
    [
        ("paper_arm", "smc", 16.0),
        ("panda", "smc", 16.0),
        ("ur5e_motors", "smc", 4.0),
        ("ur5e_motors", "fixed_time_adaptive", 2.0),
        ("iiwa_motors", "fixed_time_adaptive", 2.0),
    ],
)
def test_shipped_laws_do_not_vibrate_at_delays_that_they_hold(arm, law, delay_ms):
    words = [f"controller.law={law}", "duration_s=4", *constant(delay_ms)]
    summary = summarise(simulate(load_setup(arm, words)).data())
    assert (summary["verdict"], summary["vibrating"], summary["growing"]) == ("kept", [], [])

"""What the project claims of its laws on the nominal scenario, whatever the rivals' gains."""

from __future__ import annotations

import numpy as np
import pytest

from controller.laws import LAWS
from deploy.experiments.metrics import summarise
from deploy.experiments.settling import settling_test
from deploy.experiments.simulate import simulate
from deploy.experiments.tuning import varied, with_gains
from deploy.scenario import load_setup

RIVALS = ("pid", "smc", "tsmc", "ftsmc")


def setup_of(law, duration_s):
    return load_setup("paper_arm", [f"controller.law={law}", f"duration_s={duration_s}"])


def judged(setup):
    return summarise(simulate(setup).data())


@pytest.fixture(scope="module")
def summaries():
    return {law: judged(setup_of(law, 20)) for law in LAWS}


def rms(summary):
    return np.array(summary["tracking"]["rms_rad"])


def variation(summary):
    return np.array(summary["torque"]["total_variation_nm_per_s"])


def test_fixed_time_laws_keep_their_bounds_and_the_pid_does_not(summaries):
    assert summaries["fixed_time_neural"]["bounds"]["kept"]
    assert summaries["fixed_time_model_based"]["bounds"]["kept"]
    assert not summaries["pid"]["bounds"]["kept"]


@pytest.mark.parametrize("rival", RIVALS)
def test_neural_law_has_at_most_half_the_error_of_each_rival_on_every_joint(summaries, rival):
    assert (rms(summaries["fixed_time_neural"]) <= 0.5 * rms(summaries[rival])).all()


def test_neural_law_is_as_smooth_as_claimed(summaries):
    neural = variation(summaries["fixed_time_neural"])
    assert (neural <= 0.01 * variation(summaries["smc"])).all()
    assert (neural <= 8.0 * variation(summaries["pid"])).all()


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("rival", RIVALS)
def test_moderate_changes_of_a_rivals_gains_do_not_reverse_the_result(rival, seed):
    random = np.random.default_rng(seed)
    setup = setup_of(rival, 8)
    gains = varied(setup.gains, lambda joints: random.uniform(0.7, 1.3, joints))
    neural = rms(judged(setup_of("fixed_time_neural", 8)))
    assert (neural < rms(judged(with_gains(setup, gains)))).all()


@pytest.mark.parametrize("law", ["fixed_time_neural", "fixed_time_model_based"])
def test_settling_time_stays_below_one_bound_from_near_and_far(law):
    result = settling_test(setup_of(law, 4), offsets_rad=(0.01, 0.1, 0.5, 1.0))
    assert result.holds, result
    assert all(row.bounds_kept for row in result.rows)
    assert max(row.settling_time_s for row in result.rows) < 1.0 < result.bound_s < 5.0


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("scenario", ["paper_arm", "iiwa", "panda"])
def test_every_law_runs_on_every_arm_with_derived_gains(scenario, law):
    overrides = [f"controller.law={law}", f"controller.gains.{law}=null", "duration_s=3"]
    summary = judged(load_setup(scenario, overrides))
    assert summary["completed"]
    assert not summary["faults"]
    if law != "pid":  # which has nothing against gravity but its integral
        assert summary["bounds"]["kept"]
        assert rms(summary).max() < 5e-3
    assert rms(summary).max() < 0.1

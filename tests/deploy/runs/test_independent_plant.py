"""The laws on other physics: MuJoCo's bodies and the fourth-order Runge-Kutta rule."""

from __future__ import annotations

import numpy as np
import pytest

from controller.laws import LAWS
from deploy.runs.judging.metrics import summarise
from deploy.runs.simulate import simulate
from deploy.scenario.scenario import load_setup

SMOOTH = ("fixed_time_neural", "fixed_time_model_based", "pid")


RUNGE_KUTTA = ("plant.physics.engine=mujoco", "plant.physics.integrator=runge_kutta_4")


def rms_rad(law, physics=()):
    setup = load_setup("paper_arm", [f"controller.law={law}", "duration_s=6", *physics])
    return np.array(summarise(simulate(setup).data())["tracking"]["rms_rad"])


@pytest.fixture(scope="module")
def both():
    """RMS errors by law on the default physics and by Runge-Kutta, shape (joints,) each."""
    return tuple({law: rms_rad(law, physics) for law in LAWS} for physics in ((), RUNGE_KUTTA))


@pytest.mark.parametrize("law", SMOOTH)
def test_errors_agree_for_laws_that_do_not_chatter(both, law):
    default, runge_kutta = both
    np.testing.assert_allclose(runge_kutta[law], default[law], rtol=0.2)


def test_ranking_is_the_same(both):
    def ranking(errors):
        return sorted(errors, key=lambda law: np.log(errors[law]).mean())

    assert ranking(both[0]) == ranking(both[1])
    assert ranking(both[0])[0] == "fixed_time_neural"


def test_every_law_is_in_the_same_league_on_both(both):
    default, runge_kutta = both
    for law in LAWS:
        np.testing.assert_allclose(np.log(runge_kutta[law] / default[law]), 0.0, atol=np.log(1.5))

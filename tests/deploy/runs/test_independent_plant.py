"""The laws on physics of another make: pinocchio's bodies and RK4 instead of pybullet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from controller.laws import LAWS
from deploy.experiments.runge_kutta_arm import RungeKuttaArm
from deploy.runs.judging.metrics import summarise
from deploy.runs.simulate import simulate
from deploy.scenario.scenario import load_setup
from plant_emulator.physics.bullet.arm import BulletArm

SMOOTH = ("fixed_time_neural", "fixed_time_model_based", "pid")


def rms_rad(law, bodies=BulletArm):
    setup = load_setup("paper_arm", [f"controller.law={law}", "duration_s=6"])
    setup = replace(setup, bodies=bodies)
    return np.array(summarise(simulate(setup).data())["tracking"]["rms_rad"])


@pytest.fixture(scope="module")
def both():
    """RMS errors by law on pybullet and on pinocchio, shape (joints,) each."""
    pybullet = {law: rms_rad(law) for law in LAWS}
    pinocchio = {law: rms_rad(law, RungeKuttaArm) for law in LAWS}
    return pybullet, pinocchio


@pytest.mark.parametrize("law", SMOOTH)
def test_errors_agree_for_laws_that_do_not_chatter(both, law):
    pybullet, pinocchio = both
    np.testing.assert_allclose(pinocchio[law], pybullet[law], rtol=0.2)


def test_ranking_is_the_same(both):
    def ranking(errors):
        return sorted(errors, key=lambda law: np.log(errors[law]).mean())

    assert ranking(both[0]) == ranking(both[1])
    assert ranking(both[0])[0] == "fixed_time_neural"


def test_every_law_is_in_the_same_league_on_both(both):
    pybullet, pinocchio = both
    for law in LAWS:
        np.testing.assert_allclose(np.log(pinocchio[law] / pybullet[law]), 0.0, atol=np.log(1.5))

"""The laws on physics of another make: pinocchio's forward dynamics instead of pybullet."""

from __future__ import annotations

import numpy as np
import pytest

from controller.laws import LAWS
from controller.manipulator_model import ManipulatorModel
from deploy.runs.metrics import summarise
from deploy.runs.simulate import simulate
from deploy.scenario.scenario import load_setup
from plant_emulator.arm import arm_plant
from plant_emulator.arm.joint_torques import TOTAL, joint_torques

SMOOTH = ("fixed_time_neural", "fixed_time_model_based", "pid")


class PinocchioArm:
    """What `ArmPlant` asks of its physics, by the midpoint rule (pybullet: semi-implicit Euler)."""

    def __init__(self, robot, grid, torques, *, payload_kg=0.0, gui=False):
        self._model = ManipulatorModel(robot, payload_kg=payload_kg)
        self._grid, self._torques = grid, torques
        self.motion = np.zeros((2, robot.joints))
        self.position, self.velocity = self.motion

    def place(self, position):
        self.position[:], self.velocity[:] = position, 0.0

    def set_brakes(self, *, engaged):
        pass

    def advance(self, first, end):
        torques = self._torques
        for number in range(first, end):
            time_s = self._grid.substep_ns(number) * 1e-9
            saturated, hits = joint_torques(self.motion, time_s, torques.tables)
            torques.note(saturated=saturated, hits=hits)
            self._step(torques.tables.torques_nm[TOTAL])

    def _step(self, torque_nm):
        acceleration, step_s = self._model.forward_dynamics, self._grid.substep_s
        at_start = acceleration(self.position, self.velocity, torque_nm)
        halfway = self.position + 0.5 * step_s * self.velocity
        velocity = self.velocity + 0.5 * step_s * at_start
        self.position += step_s * velocity
        self.velocity += step_s * acceleration(halfway, velocity, torque_nm)

    def advance_braked(self, substeps):
        self.velocity[:] = 0.0

    def close(self):
        pass


def rms_rad(law):
    setup = load_setup("paper_arm", [f"controller.law={law}", "duration_s=6"])
    return np.array(summarise(simulate(setup).data())["tracking"]["rms_rad"])


@pytest.fixture(scope="module")
def both():
    """RMS errors by law on pybullet and on pinocchio, shape (joints,) each."""
    pybullet = {law: rms_rad(law) for law in LAWS}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(arm_plant, "BulletArm", PinocchioArm)
        pinocchio = {law: rms_rad(law) for law in LAWS}
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

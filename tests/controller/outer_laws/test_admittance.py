"""A law of torques in front of a robot that takes velocities."""

import numpy as np
import pytest

from controller.control_law import ABSENCE_STATES, Diagnostics, Tracking
from controller.manipulator_model import ManipulatorModel
from controller.outer_laws.admittance import Admittance
from deploy.judge.metrics import summarise
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from tests.arms import PAPER_ARM, forward_dynamics

H = 1e-3
ROBOT = (
    "controller.law=fixed_time_adaptive", "plant.interface.kind=speedj",
    "plant.interface.speedj.ideal=true", "plant.interface.rate_hz=1000",
    "plant.friction={}", "plant.disturbance={}", "duration_s=3",
)  # fmt: skip
"""The row of the documentation."""


class Steady:
    """A law whose torque stays."""

    def __init__(self, torque):
        self.diagnostics, self._torque = Diagnostics(torque.size), torque

    def torque(self, tracking):
        return self._torque

    def reset(self):
        """Nothing."""


TORQUE = np.array([30.0, -80.0, 40.0])


@pytest.fixture
def situation():
    """A law, the situation that it answers, and the acceleration of the arm there."""
    model, tracking = ManipulatorModel(PAPER_ARM), Tracking(3)
    tracking.position[:], tracking.velocity[:] = [0.2, 0.5, 0.7], [0.3, -0.4, 0.5]
    law = Admittance(Steady(TORQUE), model, np.full(3, np.inf), ABSENCE_STATES * H)
    return law, tracking, forward_dynamics(model, tracking.position, tracking.velocity, TORQUE)


def answered(law, tracking, step_s):
    tracking.step_s = step_s
    law.torque(tracking)
    return law.target(tracking).copy()


def test_target_moves_with_the_acceleration_of_the_arm(situation):
    law, tracking, acceleration = situation
    np.testing.assert_array_equal(answered(law, tracking, 0.0), [tracking.position, [0, 0, 0]])
    position, velocity = answered(law, tracking, H)
    np.testing.assert_allclose(velocity, H * acceleration, rtol=1e-9)
    np.testing.assert_allclose(position - tracking.position, H * velocity, rtol=1e-9)


def test_model_does_not_move_over_an_absence_of_states(situation):
    law, tracking, acceleration = situation
    before = [answered(law, tracking, step_s) for step_s in (0.0, H)][-1]
    np.testing.assert_array_equal(answered(law, tracking, 17 * H), before)
    after = answered(law, tracking, 16 * H)
    np.testing.assert_allclose(after[1] - before[1], 16 * H * acceleration, rtol=1e-9)


@pytest.mark.parametrize(
    "more",
    [
        (),
        ("controller.every=2",),
        ("link.uplink.schedule=[{kind: outage, at_s: 1.0005, for_s: 0.06}]",),
        ("link.uplink.schedule=[{kind: outage, at_s: 1.0005, for_s: 0.3}]",
         "plant.command_timeout_ms=1000"),
    ],
)  # fmt: skip
def test_velocity_robot_keeps_its_bounds(more):
    """Also with half as many answers, and after 60 and 300 ms without states."""
    assert summarise(simulate(load_setup("paper_arm", [*ROBOT, *more])).data())["verdict"] == "kept"

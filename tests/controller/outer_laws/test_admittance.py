"""A law of torques in front of a robot that takes velocities."""

import numpy as np
import pytest

from controller.chunks.answer import Holding
from controller.control_law import Diagnostics, Tracking
from controller.manipulator_model import ManipulatorModel
from controller.outer_laws.admittance import Admittance
from controller.slow_law import AnswerTiming, SlowLaw
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
OUTAGE = "link.uplink.schedule=[{{kind: outage, at_s: 1.0005, for_s: {}}}]"


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
    law = Admittance(Steady(TORQUE), model, np.full(3, np.inf))
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


def test_model_moves_at_every_state_while_a_slow_law_is_asked_at_some(situation):
    """With the law asked once, velocity is a t and position a h² k (k + 1) / 2 after k states."""
    _, tracking, acceleration = situation
    timing = AnswerTiming(1000, 0.0, 0.0, Holding(), H, seed=1, first_s=0.0)
    slow = SlowLaw(Steady(TORQUE), timing)
    law = Admittance(slow, ManipulatorModel(PAPER_ARM), np.full(3, np.inf))
    found = np.array([answered(law, tracking, H if k else 0.0) for k in range(40)])
    k = np.arange(40)[:, None]
    np.testing.assert_allclose(found[:, 1], k * H * acceleration, rtol=1e-9, atol=1e-12)
    moved = found[:, 0] - tracking.position
    np.testing.assert_allclose(moved, k * (k + 1) / 2 * H**2 * acceleration, rtol=1e-9, atol=1e-12)
    assert law.log is slow.log


@pytest.mark.parametrize(
    "more",
    [
        (),
        ("controller.every=2",),
        ("controller.every=2", "controller.inference_ms=1"),
        (OUTAGE.format(0.06),),
    ],
)
def test_velocity_robot_keeps_its_bounds(more):
    """Also with half as many answers, and over 60 ms without states."""
    assert summarise(simulate(load_setup("paper_arm", [*ROBOT, *more])).data())["verdict"] == "kept"


def test_velocity_robot_comes_back_after_300_ms_without_states():
    """It stops after 20 ms, and the reference leaves it; one step over 300 ms ends 3 rad away."""
    more = (OUTAGE.format(0.3), "plant.command_timeout_ms=1000")
    errors = simulate(load_setup("paper_arm", [*ROBOT, *more])).data().true_errors_rad
    assert np.abs(errors).max() > 0.01
    assert np.abs(errors[2000:]).max() < 1e-4

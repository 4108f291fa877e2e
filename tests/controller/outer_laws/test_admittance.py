"""A law of torques in front of a robot that takes velocities."""

import numpy as np
import pytest

from controller.control_law import Diagnostics, Tracking
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


@pytest.mark.parametrize(
    "more",
    [
        (),
        ("controller.every=2",),
        ("link.uplink.schedule=[{kind: outage, at_s: 1.0005, for_s: 0.06}]",),
    ],
)
def test_velocity_robot_keeps_its_bounds(more):
    """Also with half as many answers, and after 60 ms without states."""
    assert summarise(simulate(load_setup("paper_arm", [*ROBOT, *more])).data())["verdict"] == "kept"


def test_robot_returns_from_an_absence_of_states_without_a_jump():
    """After 300 ms at rest, it is away by the way of the reference; no model moved meanwhile."""
    outage = "link.uplink.schedule=[{kind: outage, at_s: 1.0005, for_s: 0.3}]"
    setup = load_setup("paper_arm", [*ROBOT, outage, "plant.command_timeout_ms=1000"])
    errors = np.abs(simulate(setup).data().true_errors_rad)
    missed = np.abs(errors[1300] - errors[1000])
    assert (errors[1300:].max(axis=0) < 2.0 * missed.max()).all()
    assert errors[2000:].max() < 1e-3


def test_model_moves_at_each_state_however_seldom_its_law_is_asked():
    """A fifth of the answers: at rest, a held torque adds as much velocity at each state."""
    setup = load_setup("paper_arm", [*ROBOT, "controller.every=5"])
    law, tracking, found = setup.control_task().law, Tracking(3), []
    tracking.position[:] = setup.start_position_rad
    for tick in range(5):
        tracking.update(H * tick, H, setup.reference, setup.funnel)
        law.torque(tracking)
        found.append(law.target(tracking).copy())
    gained = np.diff(np.array(found)[:, 1], axis=0)
    assert np.abs(gained).min() > 0.0
    np.testing.assert_allclose(gained, np.broadcast_to(gained[0], (4, 3)), rtol=1e-9)

"""Drawn tasks: reach to a moving target, and pick and place."""

from __future__ import annotations

import numpy as np
import pytest

from controller.control_law import Tracking
from controller.demonstrator import Demonstrator
from controller.funnel import Funnel
from controller.reference import sample_motion
from controller.task_references import PickConfiguration, ReachConfiguration
from tests.arms import PAPER_ARM

POSITIONS = {"centre_rad": [0.0, 0.5, -0.5], "spread_rad": [0.3, 0.2, 0.1]}
KINDS = [ReachConfiguration, PickConfiguration]
WIDE = Funnel(np.full(3, 0.3), np.full(3, 0.3), np.full(3, 0.1), 4.0)


def built(kind, **more):
    name = "reach" if kind is ReachConfiguration else "pick"
    return kind.model_validate({"kind": name, **POSITIONS, **more}).build(PAPER_ARM)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("speed", [1.0, 1.7])
def test_velocity_and_acceleration_are_derivatives_of_the_position(kind, speed):
    reference, step_s = built(kind, speed=speed), 1e-5
    for time_s in (0.4, 1.1, 2.3, 5.9):
        rows = np.empty((3, 3, 3))
        for row, at_s in zip(rows, (time_s - step_s, time_s, time_s + step_s), strict=True):
            reference.evaluate(at_s, *row)
        for order in (0, 1):
            slope = (rows[2, order] - rows[0, order]) / (2.0 * step_s)
            np.testing.assert_allclose(slope, rows[1, order + 1], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_equal_numbers_are_equal_tasks_and_others_differ_within_the_spread(kind):
    starts = []
    for task in (1, 2, 3, 1):
        position, velocity = sample_motion(built(kind, task=task), np.zeros(1), 3)
        assert (np.abs(position[0] - POSITIONS["centre_rad"]) <= POSITIONS["spread_rad"]).all()
        assert not velocity.any()  # at rest
        starts.append(position[0])
    np.testing.assert_array_equal(starts[0], starts[3])
    assert len({tuple(each) for each in starts}) == 3


def test_reach_follows_its_target_from_the_end_of_the_reach_on():
    """Position and acceleration of a sinusoid about the target: q'' = −w² (q − target)."""
    reference = built(ReachConfiguration, reach_s=1.0, frequency_rad_s=2.0)
    row, found = np.empty((3, 3)), []
    for time_s in np.linspace(1.0, 9.0, 200):
        reference.evaluate(time_s, *row)
        found.append(row.copy())
    positions, accelerations = np.array(found)[:, 0], np.array(found)[:, 2]
    for joint in range(3):
        slope, _ = np.polyfit(positions[:, joint], accelerations[:, joint], 1)
        assert 1.0 <= np.sqrt(-slope) <= 2.0  # half of the frequency, and all of it
        fit = np.polyval(
            np.polyfit(positions[:, joint], accelerations[:, joint], 1), positions[:, joint]
        )
        np.testing.assert_allclose(fit, accelerations[:, joint], atol=1e-9)


def test_demonstrator_answers_with_the_reference_and_returns_to_it():
    reference = built(ReachConfiguration)
    tracking, law = Tracking(3), Demonstrator(PAPER_ARM, actions=8, period_s=0.05, return_s=0.2)
    ahead_s = 0.7 + 0.05 * np.arange(8)
    wanted = sample_motion(reference, ahead_s, 3)
    for offset in (0.0, 0.1):
        tracking.position[:] = wanted[0, 0] + offset
        tracking.update(0.7, 0.0, reference, WIDE)
        actions = law.target(tracking)
        left = offset * np.exp(-np.arange(8) * 0.05 / 0.2)
        np.testing.assert_allclose(actions[:, 0], wanted[0] + left[:, None], atol=1e-12)
        np.testing.assert_allclose(actions[:, 1], wanted[1] - left[:, None] / 0.2, atol=1e-12)


def test_demonstrator_acts_ahead_by_the_lag_of_the_robot_unless_a_lead_is_given():
    reference = built(ReachConfiguration)
    for given, lag_s, ahead_s in ((None, 0.034, 0.034), (0.01, 0.034, 0.01), (0.0, 0.034, 0.0)):
        tracking, law = Tracking(3), Demonstrator(PAPER_ARM, actions=8, lead_s=given)
        law.make_up_for(lag_s)
        wanted = sample_motion(reference, 0.7 + ahead_s + 0.04 * np.arange(8), 3)
        tracking.position[:] = sample_motion(reference, np.array([0.7]), 3)[0, 0]
        tracking.update(0.7, 0.0, reference, WIDE)
        np.testing.assert_allclose(law.target(tracking)[:, 0], wanted[0], atol=1e-12)

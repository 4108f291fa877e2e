"""The lag of joints behind a reference."""

import numpy as np
import pytest

from deploy.judge.motion.joint_lag import lag_ms, lags_s, mean_speeds_rad_s
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup


def test_lag_behind_a_ramp_that_arrives_in_steps_is_that_of_the_steps():
    """Targets arrive every 20 ms, joints are 80 ms behind the ramp: 70 behind the steps' mean."""
    times_s = np.arange(0.0, 4.0, 1e-3)
    arrived = 0.3 * 0.02 * np.floor(times_s / 0.02 + 1e-9)
    actual = 0.3 * (times_s - 0.08)
    speeds = mean_speeds_rad_s(times_s, arrived[:, None])
    [lag_s] = lags_s((actual - arrived)[:, None], speeds)
    assert lag_s == pytest.approx(0.08 - 0.01, abs=1e-3)


def test_mean_speeds_are_centred_differences_of_100_ms():
    """By `numpy.interp` at both ends, for a motion that is a parabola: exactly its derivative."""
    times_s = np.arange(0.0, 1.0, 1e-3)
    speeds = mean_speeds_rad_s(times_s, np.column_stack([times_s**2, 3.0 * times_s]))
    assert speeds[51:-51, 0] == pytest.approx(2.0 * times_s[51:-51], abs=3e-3)
    assert speeds[:, 1] == pytest.approx(3.0)
    assert speeds[0, 0] == pytest.approx(0.05, abs=1e-9)


@pytest.mark.parametrize("rows", [0, 1])
def test_no_rows_have_no_speed(rows):
    assert mean_speeds_rad_s(np.zeros(rows), np.zeros((rows, 2))).shape == (rows, 2)


def test_an_arm_that_does_not_follow_has_no_lag():
    """Thrown by 100 rad while references move by less than 1 rad/s for 1 s."""
    data = simulate(load_setup("paper_arm", ["duration_s=1", "metrics.from_s=0"])).data()
    assert None not in lag_ms(data)
    data.true_errors_rad[:] -= 100.0 * np.sign(data.reference_velocities_rad_s)
    assert lag_ms(data) == [None] * 3

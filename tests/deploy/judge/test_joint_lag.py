"""The lag of joints behind targets that come in steps, row by row."""

import numpy as np
import pytest

from deploy.judge.joint_lag import LagMeter


def metered(times_s, actual_rad, targets_rad):
    meter = LagMeter(actual_rad.shape[1])
    for row in zip(times_s.tolist(), actual_rad, targets_rad, strict=True):
        meter.add(*row)
    return meter.finish()


def test_lag_is_that_of_steps_that_follow_a_ramp():
    """Targets every 20 ms, and joints 80 ms behind their mean: 70 behind the step of each tick."""
    times_s = np.arange(0.0, 3.0, 1e-3)
    steps = 0.3 * np.floor(times_s / 0.02 + 1e-9) * 0.02
    actual = 0.3 * (times_s - 0.08)
    columns = [each[:, None] for each in (actual, steps)]
    [lag] = metered(times_s, *columns)
    assert lag == pytest.approx(70.0, abs=1.0)
    assert metered(times_s, columns[0], np.full((3000, 1), np.nan)) == [None]


def test_lag_of_uneven_rows_with_gaps_is_that_of_least_squares_over_all_of_them():
    """Centred differences of 100 ms by `numpy.searchsorted`, and `numpy.linalg.lstsq`."""
    random = np.random.default_rng(1)
    times_s = np.cumsum(random.choice([1e-3, 2e-3, 0.03, 0.2], 2000, p=[0.6, 0.3, 0.07, 0.03]))
    targets = np.column_stack([np.sin(times_s), np.cos(2.0 * times_s)])
    actual = targets + 0.01 * random.standard_normal(targets.shape)
    targets[300:420] = np.nan
    ends, starts = (np.searchsorted(times_s, times_s + each) for each in (0.05, -0.05))
    ends = np.minimum(ends, len(times_s) - 1)
    with np.errstate(invalid="ignore"):
        speeds = (targets[ends] - targets[starts]) / (times_s[ends] - times_s[starts])[:, None]
    known = np.isfinite(speeds).all(axis=1) & np.isfinite(targets).all(axis=1)
    wanted_ms = [
        -1e3 * np.linalg.lstsq(speeds[known][:, [j]], (actual - targets)[known][:, j])[0][0]
        for j in range(2)
    ]
    assert metered(times_s, actual, targets) == pytest.approx(wanted_ms, rel=1e-9)


@pytest.mark.parametrize("rows", [0, 1])
def test_without_motion_no_joint_has_a_lag(rows):
    assert metered(np.zeros(rows), np.zeros((rows, 3)), np.zeros((rows, 3))) == 3 * [None]


def test_a_long_run_needs_no_more_memory_than_a_short_one():
    """100 ms of rows, and the two beyond them."""
    meter = LagMeter(1)
    for k in range(5000):
        meter.add(1e-3 * k, np.zeros(1), np.full(1, 1e-3 * k))
    assert len(meter._window) <= 103

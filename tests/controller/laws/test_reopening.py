import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.control_law import D_LOWER, D_UPPER, DD_LOWER, DD_UPPER, LOWER, UPPER, Tracking
from controller.laws.reopening import working_bounds

STEP_S = 1e-3


def situation(error_rad, upper_rad=0.01, lower_rad=0.02):
    """One joint in a funnel that has closed."""
    tracking = Tracking(1)
    tracking.step_s = STEP_S
    tracking.error[:] = error_rad
    tracking.bounds[[UPPER, LOWER], 0] = upper_rad, lower_rad
    return tracking


def bounds_after(*errors_rad):
    """Working bounds, in the order of `Tracking.bounds`, after these errors one tick apart."""
    opening = 0.0
    for error_rad in errors_rad:
        now = situation(error_rad)
        upper, lower, opening = working_bounds(error_rad, now.bounds[:, 0], now.step_s, opening)
    bounds = np.empty(6)
    bounds[[UPPER, D_UPPER, DD_UPPER]], bounds[[LOWER, D_LOWER, DD_LOWER]] = upper, lower
    return bounds


@given(share=st.floats(-0.98, 0.98))
def test_working_funnel_is_the_real_one_to_the_bit_while_the_error_stays_inside(share):
    error_rad = share * (0.01 if share > 0.0 else 0.02)
    assert bounds_after(error_rad).tolist() == situation(error_rad).bounds[:, 0].tolist()


@pytest.mark.parametrize("error_rad", [0.0099, 0.1, -0.0197, -3.0])
def test_error_that_got_out_uses_two_thirds_of_the_new_bound(error_rad):
    bounds = bounds_after(0.001, error_rad)
    assert abs(error_rad) / bounds[UPPER if error_rad > 0 else LOWER] == pytest.approx(2 / 3)
    # both sides open by as much
    assert bounds[UPPER] - 0.01 == pytest.approx(bounds[LOWER] - 0.02)


def test_it_closes_with_a_time_constant_of_a_quarter_of_a_second():
    opened = bounds_after(0.1)[UPPER] - 0.01
    later = bounds_after(0.1, *np.zeros(250))[UPPER] - 0.01
    assert later / opened == pytest.approx(math.exp(-1.0), rel=1e-9)


def test_derivatives_are_those_of_the_closing_funnel():
    before, now, after = (bounds_after(0.1, *np.zeros(ticks)) for ticks in (99, 100, 101))
    for side, slope, curvature in ((UPPER, D_UPPER, DD_UPPER), (LOWER, D_LOWER, DD_LOWER)):
        # central differences over ±1 ms are off by (4/s · 1 ms)²/6 and /12
        assert now[slope] == pytest.approx((after[side] - before[side]) / (2 * STEP_S), rel=3e-6)
        second = (after[side] - 2 * now[side] + before[side]) / STEP_S**2
        assert now[curvature] == pytest.approx(second, rel=2e-6)


@given(error_rad=st.floats(-1e30, 1e30))
def test_every_error_has_its_place(error_rad):
    bounds = bounds_after(error_rad)
    assert -bounds[LOWER] < error_rad < bounds[UPPER]

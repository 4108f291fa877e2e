import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.funnel import (
    Funnel,
    FunnelConfiguration,
    performance_function,
    transform,
    transformation_accelerations,
    transformation_rates,
)

BOUND = st.floats(1e-3, 2.0)
INSIDE = st.floats(-0.97, 0.97)  # share of the bound on the side of the error
STEP_S = 2e-5


def still(bound):
    """A bound that does not move."""
    return bound, 0.0, 0.0


def inverse_transform(transformed, upper, lower):
    """E = l u (E − 1) / (u + l E) with E = e^(2ε), for bounds of these sizes."""
    growth = math.exp(2.0 * transformed)
    return lower * upper * (growth - 1.0) / (upper + lower * growth)


def slope(function, at):
    """Sixth-order central difference; at our time scales (3 ms at the least) good to 1e-9."""
    weights = ((1, 45.0), (2, -9.0), (3, 1.0))
    differences = (
        weight * (function(at + k * STEP_S) - function(at - k * STEP_S)) for k, weight in weights
    )
    return math.fsum(differences) / (60.0 * STEP_S)


def error_at(share, upper, lower):
    return share * (upper if share > 0.0 else lower)


@given(share=INSIDE, upper=BOUND, lower=BOUND)
def test_inverse_undoes_the_transformation(share, upper, lower):
    error = error_at(share, upper, lower)
    back = inverse_transform(transform(error, still(upper), still(lower)), upper, lower)
    # Rounding of ln and exp alone, relative to the wider bound.
    assert back == pytest.approx(error, abs=1e-14 * max(upper, lower) / min(upper, lower))


@given(upper=BOUND, lower=BOUND, d_upper=st.floats(-9.0, 0.0), d_lower=st.floats(-9.0, 0.0))
def test_zero_error_is_zero_and_stays_so_however_unequal_the_bounds(upper, lower, d_upper, d_lower):
    assert transform(0.0, still(upper), still(lower)) == 0.0
    assert inverse_transform(0.0, upper, lower) == 0.0
    assert transformation_rates(0.0, (upper, d_upper, 0.0), (lower, d_lower, 0.0))[1] == 0.0


@given(
    initial=st.floats(0.02, 2.0), final=st.floats(1e-3, 0.02),
    rate=st.floats(0.1, 10.0), time_s=st.floats(0.0, 5.0),
)  # fmt: skip
def test_performance_function_and_its_derivatives(initial, final, rate, time_s):
    value, first, second = performance_function(time_s, initial, final, rate)
    assert final <= value <= initial
    assert first <= 0.0
    assert performance_function(0.0, initial, final, rate)[0] == pytest.approx(initial, rel=1e-15)
    assert performance_function(1e3, initial, final, rate)[0] == pytest.approx(final, rel=1e-15)
    for index, analytic in ((0, first), (1, second)):
        numeric = slope(lambda t, i=index: performance_function(t, initial, final, rate)[i], time_s)
        assert analytic == pytest.approx(numeric, rel=1e-7, abs=1e-9)


class Motion:
    """An error that swings smoothly between fractions of two bounds that shrink at unlike rates."""

    def __init__(self, initial_upper, initial_lower, rate, swing, frequency, phase):
        self.initial = (initial_upper, initial_lower)
        self.rate, self.swing, self.frequency, self.phase = rate, swing, frequency, phase

    def bounds(self, time_s):
        upper = performance_function(time_s, self.initial[0], 0.01, self.rate)
        lower = performance_function(time_s, self.initial[1], 0.01, 0.7 * self.rate)
        return upper, lower

    def error(self, time_s):
        """Error and error rate."""
        (u, d_u, _), (lo, d_lo, _) = self.bounds(time_s)
        angle = self.frequency * time_s + self.phase
        sine, cosine = self.swing * math.sin(angle), self.swing * self.frequency * math.cos(angle)
        error = 0.5 * (u - lo) + 0.5 * (u + lo) * sine
        rate = 0.5 * (d_u - d_lo) + 0.5 * (d_u + d_lo) * sine + 0.5 * (u + lo) * cosine
        return error, rate

    def transformed(self, time_s):
        return transform(self.error(time_s)[0], *self.bounds(time_s))

    def rates(self, time_s):
        return transformation_rates(self.error(time_s)[0], *self.bounds(time_s))

    def accelerations(self, time_s):
        return transformation_accelerations(*self.error(time_s), *self.bounds(time_s))


MOTIONS = st.builds(
    Motion,
    initial_upper=st.floats(0.02, 1.5),
    initial_lower=st.floats(0.02, 1.5),
    rate=st.floats(0.1, 10.0),
    swing=st.floats(0.0, 0.95),
    frequency=st.floats(0.1, 20.0),
    phase=st.floats(0.0, 2.0 * math.pi),
)
TIMES = st.floats(0.01, 3.0)
# Finite differences of a value x are good to 1e-9 of it per time scale; 1e-6 leaves a margin, and a
# wrong sign or a forgotten term is off by the order of x.
ACCURACY = 1e-6


@given(motion=MOTIONS, time_s=TIMES)
def test_rate_of_the_transformed_error_is_r_times_error_rate_minus_v(motion, time_s):
    r, v = motion.rates(time_s)
    error_rate = motion.error(time_s)[1]
    scale = r * (abs(error_rate) + abs(v)) + 1.0
    numeric = slope(motion.transformed, time_s)
    assert r * (error_rate - v) == pytest.approx(numeric, abs=ACCURACY * scale)


@given(motion=MOTIONS, time_s=TIMES)
def test_rates_of_r_and_v_along_a_motion(motion, time_s):
    d_r, d_v = motion.accelerations(time_s)
    numeric_r = slope(lambda t: motion.rates(t)[0], time_s)
    numeric_v = slope(lambda t: motion.rates(t)[1], time_s)
    r, v = motion.rates(time_s)
    assert d_r == pytest.approx(numeric_r, abs=ACCURACY * (abs(d_r) + r))
    assert d_v == pytest.approx(numeric_v, abs=ACCURACY * (abs(d_v) + abs(v) + 1.0))


@given(
    upper=st.floats(0.02, 2.0), lower=st.floats(0.02, 2.0),
    rate=st.floats(0.1, 10.0), time_s=st.floats(0.0, 20.0),
)  # fmt: skip
def test_funnel_bounds_agree_with_the_performance_function(upper, lower, rate, time_s):
    final = np.array([0.01, 0.02])
    funnel = Funnel(np.array([upper, 0.5]), np.array([lower, 0.5]), final, rate)
    above, below = funnel.bounds(np.array([0.0, time_s]))
    assert above[0].tolist() == pytest.approx([upper, 0.5], rel=1e-15)
    found = [above[1, 0], -below[1, 0], -below[1, 1]]
    starts = ((upper, 0.01), (lower, 0.01), (0.5, 0.02))
    expected = [performance_function(time_s, start, end, rate)[0] for start, end in starts]
    # exp of numpy and of the C library may differ in the last bit.
    assert found == pytest.approx(expected, rel=1e-14)


def test_ticks_are_counted_by_the_bound_on_the_side_of_the_error():
    funnel = Funnel(np.array([0.2]), np.array([0.1]), np.array([0.01]), 4.0)
    position, wanted, counts = np.ones(1), np.ones(1), np.zeros(3)
    count = funnel.counting(position, wanted, counts)
    for error in (0.15, -0.05, -0.12):
        position[0] = 1.0 + error
        count(0.0)
    assert counts.tolist() == pytest.approx([3.0, 1.0, 1.2])
    position[0] = math.nan
    count(0.0)
    assert counts.tolist() == [4.0, 2.0, math.inf]


def test_funnel_opens_wide_to_the_side_of_the_error():
    funnel = FunnelConfiguration(final_rad=0.01).build(np.array([0.5, -0.5, 0.0]))
    near, far = 1.2 * 0.5 + 0.05, 0.4 * 0.5 + 0.03
    assert funnel.initial_upper_rad.tolist() == pytest.approx([near, far, 0.05])
    assert funnel.initial_lower_rad.tolist() == pytest.approx([far, near, 0.03])
    assert funnel.final_rad.tolist() == [0.01, 0.01, 0.01]
    assert funnel.rate_per_s == 4.0


@given(offset=st.floats(-1.4, 1.4))
def test_error_starts_inside_the_default_funnel(offset):
    funnel = FunnelConfiguration().build(np.array([offset]))
    above, below = funnel.bounds(np.zeros(1))
    assert below[0, 0] < offset < above[0, 0]
    assert max(above[0, 0], -below[0, 0]) <= 1.5

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.laws.sliding_surface import sig, surface_pull, surface_pull_slope

GAINS = st.tuples(
    st.floats(0.1, 20.0),  # α₁
    st.floats(0.1, 20.0),  # α₂
    st.floats(1.05, 3.0),  # φ₁
    st.floats(0.1, 0.95),  # φ₂
    st.floats(1e-4, 0.5),  # η
)
TRANSFORMED = st.floats(-20.0, 20.0)


@given(x=st.floats(-1e6, 1e6), power=st.floats(0.1, 3.0))
def test_sig_is_the_signed_power(x, power):
    assert sig(x, power) == math.copysign(abs(x) ** power, x)
    assert sig(-x, power) == -sig(x, power)
    assert sig(0.0, power) == 0.0
    assert sig(x, 1.0) == x


@given(epsilon=TRANSFORMED, gains=GAINS)
def test_pull_is_odd_and_its_slope_even_and_positive(epsilon, gains):
    assert surface_pull(-epsilon, *gains) == -surface_pull(epsilon, *gains)
    assert surface_pull_slope(-epsilon, *gains) == surface_pull_slope(epsilon, *gains) > 0.0
    assert surface_pull(0.0, *gains) == 0.0


@given(epsilon=TRANSFORMED, gains=GAINS)
def test_pull_beyond_eta_is_the_sum_of_both_powers(epsilon, gains):
    alpha_1, alpha_2, phi_1, phi_2, eta = gains
    size = max(abs(epsilon), eta)
    expected = alpha_1 * size**phi_1 + alpha_2 * size**phi_2
    assert surface_pull(size, *gains) == pytest.approx(expected, rel=1e-14)


@given(gains=GAINS)
def test_value_and_slope_are_continuous_at_eta(gains):
    eta = gains[-1]
    inside, outside = eta * (1.0 - 1e-12), eta * (1.0 + 1e-12)
    # 2e-12 of η apart: a jump in value or slope would stand out by its own size.
    assert surface_pull(inside, *gains) == pytest.approx(surface_pull(outside, *gains), rel=1e-10)
    slope = surface_pull_slope(outside, *gains)
    assert surface_pull_slope(inside, *gains) == pytest.approx(slope, rel=1e-10)


@given(share=st.floats(-50.0, 50.0), gains=GAINS)
def test_slope_is_the_derivative_of_the_pull(share, gains):
    eta = gains[-1]
    step = 1e-6 * eta
    epsilon = share * eta
    for kink in (-eta, 0.0, eta):  # the second derivative jumps there
        if abs(epsilon - kink) < 0.01 * eta:
            epsilon = kink + 0.01 * eta
    difference = surface_pull(epsilon + step, *gains) - surface_pull(epsilon - step, *gains)
    # At steps of 1e-6 η rounding leaves 1e-9 and the third derivative 1e-8.
    assert surface_pull_slope(epsilon, *gains) == pytest.approx(difference / (2 * step), rel=1e-6)


def sliding_time(start, gains):
    """Time in which ε̇ = −ψ(ε) takes `start` to η: ∫ dε / ψ, over ln |ε| by the trapezoid rule."""
    logarithm = np.linspace(math.log(gains[-1]), math.log(abs(start)), 4001)
    epsilon = np.copysign(np.exp(logarithm), start)
    slowness = [e / surface_pull(float(e), *gains) for e in epsilon]
    return float(np.trapezoid(slowness, logarithm))


@pytest.mark.parametrize("alpha", [(5.0, 5.0), (1.0, 4.0), (3.0, 0.5)])
@pytest.mark.parametrize("phi", [(1.4, 0.6), (2.0, 0.5), (1.1, 0.9)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_sliding_into_eta_takes_less_than_the_fixed_time_from_anywhere(alpha, phi, sign):
    gains = (*alpha, *phi, 1e-4)
    bound_s = 1.0 / (alpha[0] * (phi[0] - 1.0)) + 1.0 / (alpha[1] * (1.0 - phi[1]))
    times = [sliding_time(sign * start, gains) for start in np.logspace(-3, 6, 10)]
    assert all(a < b for a, b in zip(times, times[1:], strict=False))
    assert times[-1] < bound_s

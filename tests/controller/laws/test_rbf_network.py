import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.laws.fixed_time_neural import NODE_AXIS, NODES, activate, adapt

INPUT = st.floats(-1.0, 1.0)


CENTRES = np.array([(x, y) for x in NODE_AXIS for y in NODE_AXIS])


def activation(x, y, width=0.3):
    out = np.empty(NODES)
    activate(x, y, width, out)
    return out


def test_nodes_are_a_grid_of_25_over_the_square_of_inputs():
    assert NODES == 25
    assert CENTRES.shape == (25, 2)
    assert {tuple(centre) for centre in CENTRES} == {
        (x, y) for x in (-1.0, -0.5, 0.0, 0.5, 1.0) for y in (-1.0, -0.5, 0.0, 0.5, 1.0)
    }


@given(x=INPUT, y=INPUT, width=st.floats(0.1, 2.0))
def test_activation_is_gaussian_in_the_distance(x, y, width):
    distance = np.hypot(CENTRES[:, 0] - x, CENTRES[:, 1] - y)
    expected = np.exp(-(distance**2) / (2.0 * width**2))
    np.testing.assert_allclose(activation(x, y, width), expected, rtol=1e-10, atol=1e-300)


@given(weight=st.floats(-1e3, 1e3), phi=st.floats(0.0, 1.0), s=st.floats(-10.0, 10.0))
def test_one_step_of_adaptation(weight, phi, s):
    weights = np.array([weight, 0.0])
    adapt(weights, np.array([phi, 0.0]), s, 1e-3, 500.0, 1e-2, 2e-2, 1.5, 0.5)
    leakage = 1e-2 * abs(weight) ** 1.5 + 2e-2 * abs(weight) ** 0.5
    expected = weight + 0.5 * (phi * s - math.copysign(leakage, weight))
    assert weights[0] == pytest.approx(expected, rel=1e-12, abs=1e-12)
    assert weights[1] == 0.0


@pytest.mark.parametrize("start", [1e-2, 1.0, -1e2, 1e4])
def test_without_excitation_weights_vanish_within_a_time_that_no_start_exceeds(start):
    rate, kappa, step_s = 10.0, 0.5, 1e-4
    # 1 / (Γ κ₁ (γ₁ − 1)) + 1 / (Γ κ₂ (1 − γ₂)) for γ = 1.5 and 0.5.
    bound_s = 1.0 / (rate * kappa * 0.5) + 1.0 / (rate * kappa * 0.5)
    weights, idle = np.array([start]), np.zeros(1)
    for _ in range(round(bound_s / step_s)):
        adapt(weights, idle, 0.0, step_s, rate, kappa, kappa, 1.5, 0.5)
    # An explicit step overshoots zero by at most (Γ κ dt)², the size at which |W| = Γ κ dt √|W|.
    assert abs(weights[0]) <= (rate * kappa * step_s) ** 2

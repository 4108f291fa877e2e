import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.laws.rbf_network import NODE_AXIS, NODES, activate, adapt

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


def test_node_answers_one_at_its_centre_and_one_over_root_e_at_one_width():
    for k, (x, y) in enumerate(CENTRES):
        assert activation(x, y)[k] == 1.0
        assert activation(x + 0.3, y)[k] == pytest.approx(math.exp(-0.5), rel=1e-12)
        assert activation(x, y - 0.3)[k] == pytest.approx(math.exp(-0.5), rel=1e-12)


@given(x=INPUT, y=INPUT, width=st.floats(0.1, 2.0))
def test_activation_is_gaussian_in_the_distance(x, y, width):
    distance = np.hypot(CENTRES[:, 0] - x, CENTRES[:, 1] - y)
    expected = np.exp(-(distance**2) / (2.0 * width**2))
    np.testing.assert_allclose(activation(x, y, width), expected, rtol=1e-10, atol=1e-300)


@given(x=INPUT, y=INPUT)
def test_mirrored_inputs_activate_mirrored_nodes(x, y):
    np.testing.assert_allclose(activation(-x, -y), activation(x, y)[::-1], rtol=1e-12)


@given(x=INPUT, y=INPUT)
def test_no_input_falls_between_the_nodes(x, y):
    # Half the diagonal of a cell is 0.354: the nearest node answers exp(−0.694) or more.
    assert activation(x, y).max() >= 0.499


@given(weight=st.floats(-1e3, 1e3), phi=st.floats(0.0, 1.0), s=st.floats(-10.0, 10.0))
def test_one_step_of_adaptation(weight, phi, s):
    weights = np.array([weight, 0.0])
    adapt(weights, np.array([phi, 0.0]), s, 1e-3, 500.0, 1e-2, 2e-2, 1.5, 0.5)
    leakage = 1e-2 * abs(weight) ** 1.5 + 2e-2 * abs(weight) ** 0.5
    expected = weight + 0.5 * (phi * s - math.copysign(leakage, weight))
    assert weights[0] == pytest.approx(expected, rel=1e-12, abs=1e-12)
    assert weights[1] == 0.0


@given(phi=st.floats(0.01, 1.0), s=st.floats(0.01, 10.0))
def test_adaptation_pushes_the_torque_against_the_sliding_variable(phi, s):
    # The torque is −W Φ: for s > 0 the weight grows, so the torque falls.
    weights = np.zeros(1)
    adapt(weights, np.array([phi]), s, 1e-3, 100.0, 1e-6, 1e-6, 1.4, 0.6)
    assert weights[0] == pytest.approx(0.1 * phi * s, rel=1e-12)


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

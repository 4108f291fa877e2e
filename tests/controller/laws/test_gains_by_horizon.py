"""The neural law's gains, which follow the horizon of the compensation."""

import numpy as np
import pytest

from controller.control_law import D_LOWER, D_UPPER, LOWER, UPPER, Tracking
from controller.laws.fixed_time_neural import FixedTimeNeural, FixedTimeNeuralGains
from tests.arms import PAPER_ARM

LIMITS = PAPER_ARM.effort_limits_nm
PLAIN = FixedTimeNeuralGains.from_inertia(np.array([9.7, 10.0, 0.76]))._replace(node_width=0.2)
DELAYED = PLAIN._replace(
    delayed_node_width=1.5, delayed_adaptation=0.03, delayed_k_2=0.25, half_way_s=0.024
)


def torques(gains, horizon_s, cycles=60):
    """Torques over a swinging error that comes in, the last of which the network has a share in."""
    law, tracking = FixedTimeNeural(gains, None, LIMITS), Tracking(3)
    tracking.horizon_s, tracking.step_s = horizon_s, 1e-3
    tracking.bounds[[UPPER, LOWER]] = 0.05
    tracking.bounds[[D_UPPER, D_LOWER]] = 0.0
    rows = []
    for cycle in range(cycles):
        phase = 0.05 * cycle + np.arange(3)
        tracking.error[:] = 0.02 * np.exp(-0.02 * cycle) * np.cos(phase)
        tracking.error_rate[:] = -np.exp(-0.02 * cycle) * np.sin(phase)
        rows.append(law.torque(tracking).copy())
    assert law.diagnostics.network_norm[0] > 0.0
    return np.array(rows)


@pytest.mark.parametrize(
    "others",
    [
        {"delayed_node_width": 0.01}, {"delayed_adaptation": 1e-6}, {"delayed_k_2": 0.0},
        {"half_way_s": 1e-6}, DELAYED._asdict(),
    ],
)  # fmt: skip
def test_without_a_horizon_gains_over_a_delay_change_no_bit(others):
    plain = torques(PLAIN, 0.0)
    np.testing.assert_array_equal(torques(PLAIN._replace(**others), 0.0), plain)


def test_every_gain_over_a_delay_counts_at_a_horizon():
    plain = torques(PLAIN._replace(delayed_node_width=0.2), 0.048)
    for name in ("delayed_node_width", "delayed_adaptation", "delayed_k_2"):
        gains = PLAIN._replace(**{"delayed_node_width": 0.2, name: getattr(DELAYED, name)})
        assert np.abs(torques(gains, 0.048) - plain).max() > 1.0, name


def test_half_way_gains_are_half_way():
    """Widths and rates by their geometric mean, k_2 by the arithmetic one."""
    half_way = PLAIN._replace(
        node_width=np.sqrt(0.2 * 1.5), delayed_node_width=np.sqrt(0.2 * 1.5),
        adaptation_rate=np.sqrt(0.03) * PLAIN.adaptation_rate, k_2=0.625 * PLAIN.k_2,
    )  # fmt: skip
    np.testing.assert_allclose(torques(DELAYED, 0.024), torques(half_way, 0.0), rtol=1e-9)


def test_torques_are_numbers_at_any_horizon_and_half_way_point():
    for horizon_s, half_way_s in [(1e-300, 0.024), (0.5, 1e-300), (0.0, 1e-300), (0.5, 1e300)]:
        gains = DELAYED._replace(delayed_k_2=0.0, half_way_s=half_way_s)
        assert np.isfinite(torques(gains, horizon_s)).all(), (horizon_s, half_way_s)

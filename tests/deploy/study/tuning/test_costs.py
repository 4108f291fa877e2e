"""Costs of runs: error and smoothness, saturation, and how long a delay was survived."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from deploy.studies.tune.costs import UNFINISHED, delay_cost, error_cost

SETUP = SimpleNamespace(
    funnel=SimpleNamespace(final_rad=0.01),
    robot=SimpleNamespace(effort_limits_nm=np.array([100.0, 50.0])),
)


def run(**changed):
    values = {
        "completed": True, "error": None, "violation_fraction": 0.0, "saturated_fraction": 0.0,
        "ended_early_s": None, "rms_rad": [0.001, 0.001],
        "total_variation_nm_per_s": [200.0, 100.0], "verdict": "kept", "growing": False,
        "first_violation_s": None,
    }  # fmt: skip
    return values | changed


def test_error_and_smoothness_count_as_logarithms():
    # Errors of a tenth of the bound, and torques that travel twice their limit per second.
    expected = math.log(0.1) + 0.25 * math.log(2.0)
    assert error_cost(run(), SETUP, None) == pytest.approx(expected)


def test_travel_costs_nothing_below_its_limit_and_much_above():
    assert error_cost(run(), SETUP, 2.001) == pytest.approx(math.log(0.1))
    # e times the limit on both joints: 1 for that, and 10 for the factor e.
    assert error_cost(run(), SETUP, 2.0 / math.e) == pytest.approx(math.log(0.1) + 11.0)


def test_bounds_saturation_and_failure_cost_ever_more():
    outside = error_cost(run(violation_fraction=0.1), SETUP, None)
    assert outside - error_cost(run(), SETUP, None) == pytest.approx(2.0)
    saturated = error_cost(run(saturated_fraction=0.2), SETUP, None)
    assert saturated - error_cost(run(), SETUP, None) == pytest.approx(3.0)
    assert error_cost(run(completed=False), SETUP, None) == UNFINISHED
    failed = run(error="no", violation_fraction=None, completed=False)
    assert error_cost(failed, SETUP, None) == UNFINISHED


def test_each_delay_that_is_kept_is_worth_1_and_a_late_loss_up_to_half():
    lost = run(verdict="lost", first_violation_s=1.0)
    assert delay_cost([run(), run(), lost], 4.0) == pytest.approx(-2.125)
    assert delay_cost([run(growing=True)], 4.0) == 0.0
    assert delay_cost([run(verdict="lost", first_violation_s=9.0)], 4.0) == -0.5


def test_a_law_without_torque_has_a_cost_that_can_be_compared():
    without = run(total_variation_nm_per_s=[0.0, 0.0])
    assert -10.0 < error_cost(without, SETUP, None) - error_cost(run(), SETUP, None) < 0.0
    assert error_cost(without, SETUP, 2.0) == pytest.approx(math.log(0.1))
    assert error_cost(run(rms_rad=[math.inf, 0.001]), SETUP, None) == UNFINISHED

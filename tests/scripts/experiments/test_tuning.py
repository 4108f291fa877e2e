from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from controller.laws import COMPARED_LAWS
from deploy.judge.metrics import summarise
from deploy.run.simulate import simulate
from scripts.experiments.tuning import (
    EXCESS_WEIGHT,
    FIXED,
    SATURATED,
    SMOOTHNESS_WEIGHT,
    START_S,
    cost,
    entries,
    scaled,
    trial,
    tune,
    tuning_setup,
    varied,
    with_gains,
)


@pytest.mark.parametrize("law", COMPARED_LAWS)
def test_every_tuned_number_has_a_factor_of_its_own_and_structure_stays(law):
    gains = tuning_setup("paper_arm", law).gains
    factors = np.linspace(-1.0, 1.0, entries(gains))
    before, after = gains._asdict(), scaled(gains, factors)._asdict()
    seen = [
        np.atleast_1d(np.log(after[name] / before[name])) for name in before if name not in FIXED
    ]
    np.testing.assert_allclose(np.concatenate(seen), factors, atol=1e-12)
    assert all(after[name] == before[name] for name in before if name in FIXED)
    assert {type(value) for value in after.values()} <= {float, np.ndarray}


def short(law, duration_s=1.0):
    setup = tuning_setup("paper_arm", law)
    metrics = setup.scenario.metrics.model_copy(update={"from_s": 0.5})
    changes = {"duration_s": duration_s, "metrics": metrics}
    return replace(setup, scenario=setup.scenario.model_copy(update=changes))


def test_a_torque_at_its_limit_is_a_failure_known_after_the_start():
    setup = short("pid")
    hard = with_gains(setup, varied(setup.gains, lambda count: np.full(count, 30.0)))
    reached, simulated_s = trial(hard)
    assert reached > SATURATED
    assert simulated_s == START_S
    assert trial(setup)[1] == START_S + 1.0


def test_with_a_limit_travel_costs_nothing_below_it_and_much_above():
    setup = short("pid")
    torque = summarise(simulate(setup).data())["torque"]
    travel_per_s = torque["total_variation_nm_per_s"] / setup.robot.effort_limits_nm
    free = cost(setup, 1e9)
    assert cost(setup, 1.001 * travel_per_s.max()) == free
    # Without a limit all travel counts, by its logarithm.
    assert cost(setup) - free == pytest.approx(SMOOTHNESS_WEIGHT * np.log(travel_per_s).mean())
    # e times the limit, or more, on every joint: 1 for being beyond it, 10 for each factor e.
    limit_per_s = travel_per_s.min() / math.e
    excess = np.log(travel_per_s / limit_per_s).mean()
    assert cost(setup, limit_per_s) - free == pytest.approx(1.0 + EXCESS_WEIGHT * excess)


def test_a_search_repeats_itself_and_never_spends_much_more_than_its_budget():
    gains, reached = tune(short("pid", 0.6), budget_s=2.0, seed=3)
    again, reached_again = tune(short("pid", 0.6), budget_s=2.0, seed=3)
    assert reached == reached_again
    assert np.concatenate(gains).tolist() == np.concatenate(again).tolist()

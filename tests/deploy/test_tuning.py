from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from controller.laws import LAWS
from deploy.experiments.tuning import (
    FIXED,
    SATURATED,
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


@pytest.mark.parametrize("law", LAWS)
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


def test_all_laws_are_tuned_on_the_same_arm_with_hardware_and_delay():
    setups = [tuning_setup("paper_arm", law) for law in LAWS]
    assert len({setup.scenario.plant.model_dump_json() for setup in setups}) == 1
    assert len({setup.scenario.link.model_dump_json() for setup in setups}) == 1
    channels = setups[0].scenario.link
    assert channels.uplink.delay_ms + channels.downlink.delay_ms == 1.0  # a control period
    assert (setups[0].scenario.plant.encoder.velocity_noise_rad_s > 0.0).all()


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


def test_leaving_the_funnel_costs_more_than_a_factor_e_in_error():
    setup = short("pid")
    wide = replace(setup, funnel=replace(setup.funnel, rate_per_s=1e-6))
    assert cost(setup) - cost(wide) > 1.0


def test_a_search_repeats_itself_and_never_spends_much_more_than_its_budget():
    gains, reached = tune(short("pid", 0.6), budget_s=2.0, seed=3)
    again, reached_again = tune(short("pid", 0.6), budget_s=2.0, seed=3)
    assert reached == reached_again
    assert np.concatenate(gains).tolist() == np.concatenate(again).tolist()

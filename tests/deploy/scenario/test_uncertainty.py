"""Plants drawn from what is uncertain: the same for a seed, and values that scenarios take."""

from __future__ import annotations

import json
import math

import numpy as np

from deploy.scenario.effective import effective_scenario
from deploy.scenario.scenario import load_setup
from deploy.scenario.uncertainty import Draw, draw_plant
from deploy.scenario.yaml_files import plain

COULOMB, STRIBECK = "plant.friction.coulomb_nm", "plant.friction.stribeck_nm"
UNIFORM = {"distribution": "uniform", "from": 1.0, "to": 3.0}
RANGES = {
    "plant.payload_kg": UNIFORM,
    COULOMB: {"distribution": "log_uniform", "from": 0.5, "to": 2, "per": "joint",
              "relative": True},
    STRIBECK: {"distribution": "uniform", "from": 0, "to": 0.5, "per": "joint",
               "relative": COULOMB},
    "plant.actuator.lag_ms": {"distribution": "choice", "values": [0, 2]},
    "robot.initial_offset_rad": {"distribution": "uniform", "from": 0.2, "to": 1, "per": "joint",
                                 "relative": True, "random_sign": True},
}  # fmt: skip


def draws(ranges):
    return {key: Draw.model_validate(values) for key, values in ranges.items()}


def drawn(number, ranges=RANGES, seed=1, scenario="paper_arm"):
    setup = load_setup(scenario)
    values = plain(setup.scenario)
    return draw_plant(draws(ranges), values, setup.robot.joints, seed=seed, number=number)


def test_a_plant_is_values_that_the_scenario_takes():
    plant = drawn(3)
    scenario = load_setup("paper_arm", plant.overrides).scenario
    assert 1.0 <= scenario.plant.payload_kg <= 3.0
    assert scenario.plant.actuator.lag_ms in (0.0, 2.0)
    # The scenario has 8, 6 and 4 N m, and starts 0.15, -0.12 and 0.10 rad off.
    factors = scenario.plant.friction.coulomb_nm / [8.0, 6.0, 4.0]
    np.testing.assert_allclose(factors, plant.draws[COULOMB], rtol=1e-12)
    assert np.all((factors >= 0.5) & (factors <= 2.0))
    shares = scenario.plant.friction.stribeck_nm / scenario.plant.friction.coulomb_nm
    np.testing.assert_allclose(shares, plant.draws[STRIBECK], rtol=1e-12)
    offset = scenario.robot.initial_offset_rad / [0.15, -0.12, 0.10]
    assert np.all((np.abs(offset) >= 0.2) & (np.abs(offset) <= 1.0))


def test_draws_stay_within_their_range_and_use_all_of_it():
    draws = [drawn(number).draws for number in range(1, 201)]
    coulomb = np.array([each[COULOMB] for each in draws])
    assert coulomb.shape == (200, 3)
    assert 0.5 <= coulomb.min() < 0.52
    assert 1.95 < coulomb.max() <= 2.0
    # Log-uniform: half of 600 draws below 1, give or take 4 standard deviations of 12.
    assert abs((coulomb < 1.0).sum() - 300) < 49
    signs = np.sign([each["robot.initial_offset_rad"] for each in draws])
    assert abs(signs.sum()) < 4 * math.sqrt(600)


def test_a_quantity_has_a_stream_of_its_own():
    alone = drawn(5, {COULOMB: RANGES[COULOMB]}).draws[COULOMB]
    assert drawn(5).draws[COULOMB] == alone
    assert drawn(6).draws[COULOMB] != alone
    assert drawn(5, seed=2).draws[COULOMB] != alone
    assert len(set(alone)) == 3


def test_tied_keys_take_the_same_draw_in_any_order():
    both = "link.uplink.delay_ms, link.downlink.delay_ms"
    plant = drawn(1, {both: UNIFORM})
    assert plant.values["link.uplink.delay_ms"] == plant.values["link.downlink.delay_ms"]
    turned = drawn(1, {"link.downlink.delay_ms,link.uplink.delay_ms": UNIFORM})
    assert turned.values == plant.values


def test_a_sign_is_drawn_as_a_factor():
    signs = {"robot.initial_offset_rad": {"distribution": "sign", "per": "joint", "relative": True}}
    offsets = [drawn(n, signs).values["robot.initial_offset_rad"] for n in range(1, 9)]
    assert {tuple(np.abs(offset)) for offset in offsets} == {(0.15, 0.12, 0.10)}
    assert len({tuple(offset) for offset in offsets}) > 1


def test_what_is_uncertain_changes_nothing_in_a_run_and_is_written_out(tmp_path):
    given = [f"uncertainty={json.dumps(RANGES)}"]
    certain, uncertain = load_setup("paper_arm"), load_setup("paper_arm", given)
    assert plain(certain.scenario) == {**plain(uncertain.scenario), "uncertainty": {}}
    file = tmp_path / "again.yaml"
    file.write_text(effective_scenario(uncertain))
    assert load_setup(str(file)).scenario.uncertainty == uncertain.scenario.uncertainty

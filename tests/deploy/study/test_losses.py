"""Shares with their intervals, and what lost plants have in common."""

from __future__ import annotations

import numpy as np
import pytest

from deploy.judge.findings.link_delays import share_interval
from deploy.study.losses import rank_losses, share_kept
from deploy.study.plants import Measured
from deploy.study.statistics import commonest_error

RISING = Measured("rising", np.arange(20.0))
RANDOM = np.random.default_rng(1)


def test_wilsons_interval_is_that_of_the_textbook():
    # Newcombe (1998): 81 of 263 is 0.2553 to 0.3662; 0 of 20 is 0 to 0.1611.
    assert share_interval(81, 263) == pytest.approx((0.2553, 0.3662), abs=1e-4)
    assert share_interval(0, 20) == pytest.approx((0.0, 0.1611), abs=1e-4)
    assert share_interval(20, 20) == pytest.approx((0.8389, 1.0), abs=1e-4)
    assert share_kept(0, 0)["wilson_95"] is None


def test_a_share_says_how_sure_it_is():
    share = share_kept(19, 20)
    assert (share["kept"], share["total"], share["fraction"]) == (19, 20, 0.95)
    assert share["wilson_95"] == pytest.approx([0.7639, 0.9911], abs=1e-4)
    assert share_kept(0, 0)["fraction"] is None


def test_effects_are_one_where_all_lost_plants_have_more_and_minus_one_where_less():
    lost = np.arange(20)[None, :] >= 14
    falling = Measured("falling", -np.arange(20.0))
    equal = Measured("equal", np.ones(20))
    found = rank_losses([equal, RISING, falling], lost)
    assert (found["lost_plants"], found["kept_plants"]) == (6, 14)
    effects = {one["quantity"]: one["effect"] for one in found["effects"]}
    assert effects == pytest.approx({"rising": 1.0, "falling": -1.0, "equal": 0.0})
    assert found["effects"][-1]["quantity"] == "equal"


def test_an_effect_is_twice_the_share_of_pairs_less_one():
    lost = np.zeros((1, 20), dtype=bool)
    lost[0, [3, 10, 19]] = True
    # Of 17 kept plants 3, 9 and 17 have less: 29 of 51 pairs.
    (only,) = rank_losses([RISING], lost)["effects"]
    assert only["effect"] == pytest.approx(2 * 29 / 51 - 1)


def test_pairs_are_formed_within_each_value():
    lost = np.array([np.arange(20) >= 17, np.arange(20) < 5, np.ones(20), np.zeros(20)], dtype=bool)
    # At the first value all 3 × 17 pairs rise, at the second all 5 × 15 fall; the rest has none.
    (only,) = rank_losses([RISING], lost)["effects"]
    assert only["effect"] == pytest.approx((51 - 75) / (51 + 75))


def test_what_chance_may_give_grows_with_the_number_of_quantities():
    lost = RANDOM.uniform(size=(1, 40)) < 0.4
    many = [Measured(f"q{i}", RANDOM.uniform(size=40)) for i in range(30)]
    one, thirty = (rank_losses(some, lost)["chance_level"] for some in (many[:1], many))
    # One effect: 1.96 standard deviations, each about sqrt((40 + 1) / (3 · 16 · 24)) = 0.19.
    assert one == pytest.approx(0.37, abs=0.05)
    assert 0.5 < thirty < 0.7


@pytest.mark.parametrize("lost_of_20", [0, 2, 18, 20])
def test_too_few_plants_give_no_effects(lost_of_20):
    found = rank_losses([RISING], np.arange(20)[None, :] < lost_of_20)
    assert found["effects"] is None
    assert found["chance_level"] is None
    assert (found["lost_plants"], found["kept_plants"]) == (lost_of_20, 20 - lost_of_20)


def test_commonest_error_is_the_first_of_each_run():
    errors = [
        "law my:Law failed at tick 50: boom; no valid command for 200 ms: safe stop",
        "law my:Law failed at tick 51: boom; the controller has left the bus",
        "no valid command for 200 ms: safe stop", None,
    ]  # fmt: skip
    text = commonest_error([{"error": error} for error in errors])
    assert text == "law my:Law failed at tick 50: boom"

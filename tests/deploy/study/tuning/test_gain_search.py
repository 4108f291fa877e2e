"""The search for gains finds the least cost, repeats itself, and changes only what is tuned."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bus_schema.errors import InputError
from controller.laws import TORQUE_LAWS
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import plain
from deploy.studies.tune.gain_search import FIXED, GainSearch

pytest.importorskip("cma", reason="the extra tuning is not installed")
START = {"stiffness": [100.0, 50.0], "damping": 10.0, "integral": 0.0, "power": 0.5}


def distance(gains) -> float:
    """Squared distance of the logarithms from 300, 20 and 10."""
    found = np.log([*gains["stiffness"], gains["damping"]])
    return float(np.sum((found - np.log([300.0, 20.0, 10.0])) ** 2))


def searched(cost, start=START, budget=200, ranges=None, seed=1):
    search = GainSearch(start, budget, seed, ranges or {})
    while not search.is_over:
        search.tell([cost(each) for each in search.candidates[len(search.costs) :]])
    return search


def test_it_finds_the_least_cost_with_its_budget_and_no_more():
    search = searched(distance)
    assert len(search.candidates) == len(search.costs) == 200
    assert search.candidates[0] == START
    assert min(search.costs) < 1e-3 < search.costs[0]
    assert search.spread < 0.1
    found = search.candidates[search.best]
    assert (found["integral"], found["power"]) == (0.0, 0.5)  # no factor, and a power


def test_it_repeats_itself_and_gains_have_four_digits():
    search = searched(distance, budget=30)
    assert search.candidates == searched(distance, budget=30).candidates
    assert search.candidates != searched(distance, budget=30, seed=2).candidates
    for gains in search.candidates[1:]:
        assert gains["damping"] == float(f"{gains['damping']:.4g}")


def test_searches_that_interleave_find_what_they_find_alone():
    alone = searched(distance, budget=40).candidates
    first, second = (GainSearch(START, 40, seed, {}) for seed in (1, 2))
    while not first.is_over:
        for search in (second, first):
            if not search.is_over:
                new = search.candidates[len(search.costs) :]
                search.tell([distance(each) for each in new])
        np.random.uniform(size=3)  # noqa: NPY002 - others use the global generator, too
    assert first.candidates == alone


def test_ranges_limit_gains_and_move_a_start_beyond_them():
    search = searched(distance, ranges={"stiffness": (60.0, 200.0), "damping": (1.0, 5.0)})
    assert search.candidates[0]["stiffness"] == [100.0, pytest.approx(math.sqrt(60 * 200))]
    for gains in search.candidates:
        assert all(60.0 - 0.05 <= each <= 200.05 for each in gains["stiffness"])
        assert 0.999 <= gains["damping"] <= 5.001
    best = search.candidates[search.best]
    assert best["stiffness"] == pytest.approx([200.0, 60.0], rel=0.05)


def test_one_gain_is_enough_and_none_is_refused():
    search = searched(lambda gains: math.log(gains["k"] / 7.0) ** 2, {"k": 1.0}, budget=100)
    assert search.candidates[search.best]["k"] == pytest.approx(7.0, rel=0.01)
    with pytest.raises(InputError, match="no gain above 0"):
        GainSearch({"power": 0.5, "k": 0.0}, 10, 1, {})


@pytest.mark.parametrize("law", TORQUE_LAWS)
def test_every_law_has_numbers_to_tune_and_keeps_its_powers(law):
    start = plain(load_setup("paper_arm", [f"controller.law={law}"]).gains)
    first, other = GainSearch(start, 10, 1, {}), start
    first.tell([0.0])
    other = first.candidates[1]
    changed = {name for name in start if other[name] != start[name]}
    assert changed
    assert not changed & FIXED
    assert {name: np.shape(value) for name, value in other.items()} == {
        name: np.shape(value) for name, value in start.items()
    }

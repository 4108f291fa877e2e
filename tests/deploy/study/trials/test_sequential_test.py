"""The sequential test decides with fewer items, about as surely, and states its errors."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

from deploy.study.trials.sequential_test import SequentialTest

DESIGNS = [(0.95, 60), (0.95, 40), (0.9, 60), (0.5, 30), (0.95, 5), (1.0, 2), (1.0, 1)]


def ends_of(test, share, draws=2000):
    """Kept, lost and decision of simulated tests, when this share of all items is kept."""
    random, found, decide = np.random.default_rng(1), [], cache(test.decide)
    for _ in range(draws):
        counts = [0, 0]
        while (passes := decide(*counts)) is None:
            counts[int(random.uniform() >= share)] += 1
        found.append((*counts, passes))
    return found


@pytest.mark.parametrize(("share", "most"), DESIGNS)
def test_stated_errors_are_those_of_simulated_tests(share, most):
    test = SequentialTest(share, most)
    stated = test.error_probabilities
    passes = np.mean([passes for *_, passes in ends_of(test, stated["poor_share"])])
    fails = np.mean([not passes for *_, passes in ends_of(test, stated["good_share"])])
    assert passes == pytest.approx(stated["passes_at_poor_share"], abs=0.02)
    assert fails == pytest.approx(stated["fails_at_good_share"], abs=0.02)
    assert stated["poor_share"] < share or share == 1.0
    assert max(passes, fails) < 0.09


@pytest.mark.parametrize(("share", "most"), DESIGNS)
def test_no_test_needs_more_than_the_fixed_number_and_there_the_share_decides(share, most):
    test = SequentialTest(share, most)
    for lost in range(most + 1):
        kept = most - lost
        assert test.decide(kept, lost) is (kept >= share * most - 1e-9)


def test_60_plants_are_decided_by_27_kept_or_by_a_few_lost_ones():
    test = SequentialTest(0.95, 60)
    assert [test.decide(kept, 0) for kept in (26, 27)] == [None, True]
    assert [test.decide(0, lost) for lost in (1, 2)] == [None, False]
    assert test.poor_share == pytest.approx(0.876, abs=1e-3)
    assert test.good_share == pytest.approx(0.977, abs=1e-3)


def test_a_few_plants_pass_only_if_all_were_tried():
    test = SequentialTest(0.95, 4)
    assert [test.decide(kept, 0) for kept in range(5)] == [None, None, None, None, True]
    assert test.decide(0, 1) is False


def test_intervals_have_the_share_in_95_of_100_tests():
    test = SequentialTest(0.95, 60)
    interval = cache(test.interval)
    for share in (0.3, 0.7, 0.88, 0.95, 0.99):
        limits = [interval(kept, lost) for kept, lost, _ in ends_of(test, share)]
        assert np.mean([low <= share <= high for low, high in limits]) > 0.94


def test_intervals_at_the_fixed_number_are_clopper_and_pearsons():
    # Of a test that cannot end earlier by its ratio: 4 of 4 kept is 0.398 to 1.
    assert SequentialTest(0.95, 4).interval(4, 0) == pytest.approx((0.025**0.25, 1.0))


def test_a_thousand_plants_have_finite_probabilities():
    stated = SequentialTest(0.95, 1000).error_probabilities
    assert all(math.isfinite(value) and 0.0 < value < 1.0 for value in stated.values())

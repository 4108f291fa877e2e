"""The search for the largest value that holds, on made-up plants."""

from __future__ import annotations

import pytest

from deploy.study.margin import MarginSearch
from deploy.study.quantities import Steps


def found(holds, first=2, limit=256):
    """A finished search and the values it probed, in order."""
    search, probed = MarginSearch(Steps(0.0, 1.0, first, limit)), []
    while (value := search.next()) is not None:
        probed.append(value)
        search.outcomes[value] = holds(value)
    return search, probed


@pytest.mark.parametrize("margin", [0, 1, 2, 7, 31, 32, 100, 255])
def test_the_largest_value_that_holds_is_found_to_one_step(margin):
    search, probed = found(lambda value: value <= margin)
    assert search.margin == margin
    assert search.first_failure == margin + 1
    assert search.held_again == []
    assert len(set(probed)) == len(probed)


def test_values_are_doubled_until_one_fails_then_halved_then_looked_at_beyond():
    _, probed = found(lambda value: value <= 9)
    # 16 fails; 12 and 10 fail, 9 holds on the way down; beyond the first failure, 10: 15 and 20.
    assert probed == [0, 2, 4, 8, 16, 12, 10, 9, 15, 20]


def test_what_fails_at_zero_has_no_margin():
    search, probed = found(lambda _: False)
    assert probed == [0]
    assert search.margin is None
    assert search.first_failure == 0


def test_what_never_fails_holds_at_the_limit():
    search, probed = found(lambda _: True, limit=50)
    assert probed[-1] == 50
    assert search.margin == 50
    assert search.first_failure is None


def test_larger_values_that_hold_again_are_told_and_do_not_count():
    search, _ = found(lambda value: value <= 9 or value == 15)
    assert search.margin == 9
    assert search.held_again == [15]


@pytest.mark.parametrize("margin", [0, 3, 20, 200])
def test_what_is_left_is_never_too_much_once_a_value_has_failed(margin):
    search = MarginSearch(Steps(0.0, 1.0, 2, 256))
    probed = 0
    expected = None
    while (value := search.next()) is not None:
        if search.first_failure is not None and expected is None:
            expected = probed + search.probes_left
        search.outcomes[value] = value <= margin
        probed += 1
    assert search.probes_left == 0
    assert expected is None or probed <= expected

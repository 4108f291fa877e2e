"""The largest number of runs of a study never rises, whatever its runs show."""

from __future__ import annotations

import random

import pytest

from deploy.studies.datasheet.data_sheet import DataSheet
from deploy.study.execution.runner import carry_out
from deploy.study.margin_search import PARTS, MarginSearch, Steps
from tests.deploy.study.studies import Here, folder_of, made_up, margin_of


def totals_of(search, lost, *, holds_again):
    """Probe until the search ends; return done and left, before the first and after each.

    Values from `lost` on are lost, but those beyond hold again once the failure is bracketed.
    """
    totals = [search.probes_at_most]
    while (steps := search.next()) is not None:
        search.outcomes[steps] = steps < lost or (holds_again and search.first_failure == lost)
        totals.append(len(search.outcomes) + search.probes_at_most)
    return totals


@pytest.mark.parametrize("parts", [1, 3, PARTS])
def test_probes_at_most_never_rise_wherever_values_are_lost(parts):
    numbers = random.Random(parts)
    for _ in range(1500):
        limit = numbers.randint(1, 400)
        lost = numbers.randint(0, limit + 1)
        hints = [numbers.randint(1, limit) for _ in range(numbers.randint(0, 2))]
        steps = Steps(0.0, 0.5, numbers.randint(1, limit), limit)
        search = MarginSearch(steps, hints=list(dict.fromkeys(hints)), parts=parts)
        totals = totals_of(search, lost, holds_again=numbers.random() < 0.3)
        assert totals == sorted(totals, reverse=True), (search, totals)
        assert totals[-1] == len(search.outcomes)


def lost_from(limit_ms):
    """Rows of runs that are lost at this delay and above."""

    def row(run):
        return made_up(run, violation_fraction=0.01 * (run.columns["value"] >= limit_ms))

    return row


@pytest.mark.parametrize("limit_ms", [0.0, 3.0, 700.0])
def test_the_margin_of_a_data_sheet_has_a_total_that_only_shrinks(tmp_path, limit_ms):
    study = DataSheet("paper_arm", "pid", is_quick=True).margin()
    totals, workers = [study.at_most], Here(lost_from(limit_ms))
    carry_out(
        study, workers, folder_of(study, tmp_path / "out"), workers.stop,
        lambda _row, at_most, _before: totals.append(at_most),
    )  # fmt: skip
    assert totals == sorted(totals, reverse=True)
    assert totals[-1] == len(totals) - 1
    assert totals[0] > totals[-1]


def test_random_runs_count_with_every_seed_from_the_start(tmp_path):
    study, totals = margin_of(), []
    totals.append(study.at_most)
    workers = Here(lost_from(4.0))
    carry_out(
        study, workers, folder_of(study, tmp_path / "out"), workers.stop,
        lambda _row, at_most, _before: totals.append(at_most),
    )  # fmt: skip
    assert totals == sorted(totals, reverse=True)
    assert totals[-1] == len(totals) - 1

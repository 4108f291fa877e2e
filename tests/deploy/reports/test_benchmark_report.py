"""The page of a benchmark: who comes first, and what is not known yet."""

from __future__ import annotations

from deploy.reports.figures.study_figures import DrawnStudy
from deploy.reports.html import write_page
from deploy.studies.benchmark.page import benchmark_page


def cell(arm, law, kept_ms, *, gains="given", plants=()):
    return {
        "scenario": arm, "law": law, "predictor": "none", "gains": gains, "margin_ms": kept_ms,
        "any_pattern_ms": kept_ms, "rms_rad": [1e-3], "travel_nm_per_s": [1.0], "networks": {},
        "plants_kept": [{"round_trip_ms": 1.0, "kept": kept, "total": 4} for kept in plants],
    }  # fmt: skip


def page_of(*cells, **more):
    summary = {
        "name": "b", "completed": True, "runs": 9, "runs_expected": 9, "delays_ms": [1.0, 8.0],
        "networks": [], "plants": None, "cells": list(cells), **more,
    }  # fmt: skip
    return benchmark_page(DrawnStudy(summary, lambda point: point))


def ranked(page):
    return [tuple(each.text for each in row[:3]) for row in page.tables[0].cells]


def test_gains_tuned_on_one_arm_do_not_rank_before_those_of_every_arm():
    easy = cell("easy", "smc", 8.0), cell("easy", "smc", 8.0, gains="tuned")
    page = page_of(*easy, cell("hard", "smc", 1.0))
    assert ranked(page) == [("smc", "none", "given"), ("smc", "none", "tuned")]
    assert [row[-1].text for row in page.tables[0].cells] == ["2 of 2", "1 of 2"]
    (panel, _) = page.panels()
    assert list(panel.draw(page.subject).data[0].y) == [100.0, 50.0]
    assert page.verdict.headline.endswith("1 ms, by smc with predictor none and given gains")


def test_a_benchmark_shows_the_predictor_of_the_best_before_it_tells(tmp_path):
    best = {**cell("easy", "smc", 8.0), "predictor": "smith"}
    write_page(tmp_path / "report.html", page_of(cell("easy", "smc", 1.0), best))
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<h1>Largest delay that every arm and pattern kept: 8 ms, by smc with predictor" in page
    assert page.index('class="lede"') < page.index("benchmark-smith") < page.index("<table")
    assert page.index("<table") < page.index("benchmark-none")


def test_an_unfinished_benchmark_names_no_winner():
    page = page_of(cell("easy", "smc", 8.0), completed=False, runs=2)
    assert page.verdict.headline.endswith("not complete")
    assert page.verdict.reasons[0].startswith("2 of about 9 runs")


def test_laws_that_are_alike_are_counted_and_none_wins_if_all_are_lost():
    page = page_of(cell("easy", "smc", 8.0), cell("easy", "pid", 8.0))
    assert page.verdict.headline.endswith("given gains; 1 more kept as much")
    page = page_of(cell("easy", "smc", 0.0))
    assert page.verdict.headline == "No law with any predictor kept 1 ms on every arm"


def test_plants_of_an_arm_that_is_lost_count_as_lost():
    page = page_of(cell("easy", "smc", 1.0, plants=[4]), cell("hard", "smc", 0.0), plants=4)
    (panel, _) = page.panels()
    assert panel.draw(page.subject).data[0].y[0] == 50.0


def test_a_law_without_gravity_term_that_is_lost_at_once_names_the_one_that_has_it():
    lost = [{**cell(arm, "pid", 0.0), "losses": {"no gravity term": 1}} for arm in ("a", "b")]
    reasons = page_of(*lost, cell("a", "pid_gravity", 8.0), cell("b", "pid_gravity", 8.0)).verdict
    sentence = "pid is lost already at 1 ms on a and b: it has no gravity term, which pid_gravity"
    assert [each for each in reasons.reasons if sentence in each]
    later = page_of({**cell("a", "pid", 1.0), "losses": {"no gravity term": 1}}).verdict.reasons
    assert not [each for each in later if "gravity" in each]

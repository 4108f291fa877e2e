"""A run that only has to be kept or lost ends soon after its loss, with the same reason."""

from __future__ import annotations

import pytest

from deploy.judge.run_rows import is_whole, left_nothing, read_rows, tolerated
from deploy.study.planned_run import PlannedRun, row_of
from deploy.study.statistics import badness, spread_of_runs, without_effect
from tests.deploy.own_laws import own_law
from tests.deploy.study.studies import made_up

REASON = ("verdict", "first_violation_s", "loss_reason", "loss_joint", "seed_used", "law")


def rows_of(*overrides):
    """The rows of a run that lasts to its end, and of one that ends at its loss."""
    given = ("duration_s=3", "metrics.from_s=0", *overrides)
    runs = [PlannedRun("p", "paper_arm", given, 1, {}, ends_early=early) for early in (False, True)]
    return [row_of(run) for run in runs]


def delayed(law, round_trip_ms):
    each = round_trip_ms / 2
    return (f"controller.law={law}", f"link.uplink.delay_ms={each}",
            f"link.downlink.delay_ms={each}")  # fmt: skip


@pytest.mark.parametrize(
    ("law", "round_trip_ms", "reason"),
    [
        ("fixed_time_neural", 8, "growing"),
        ("pid", 30, "delay"),
        ("smc", 200, "start"),
    ],
)
def test_a_lost_run_ends_early_and_has_the_reason_of_the_whole_run(law, round_trip_ms, reason):
    whole, early = rows_of(*delayed(law, round_trip_ms))
    assert [early[name] for name in REASON] == [whole[name] for name in REASON]
    assert early["loss_reason"] == reason
    assert early["ended_early_s"] == early["duration_s"] < 0.9 < whole["duration_s"] == 3.0
    assert whole["ended_early_s"] is None
    assert not early["completed"]
    acts_s = round_trip_ms * 1e-3 if reason == "start" else 0.0
    wanted_s = max(early["first_violation_s"], acts_s) + 0.3
    assert early["duration_s"] == pytest.approx(wanted_s, abs=2e-3)


def test_an_early_row_has_nothing_of_a_whole_run():
    _, early = rows_of(*delayed("fixed_time_neural", 8))
    known = {name for name, value in early.items() if value is not None}
    of_whole_runs = {
        "violation_fraction", "margin_min", "rms_rad", "max_abs_rad", "settling_time_s", "motion",
        "total_variation_nm_per_s", "rms_nm", "peak_nm", "saturated_fraction", "growing",
        "deadline_misses", "success_rate", "uplink_sent", "downlink_delay_mean_ms",
    }  # fmt: skip
    assert not known & of_whole_runs


def test_a_kept_run_is_the_same_with_and_without():
    whole, early = rows_of(*delayed("smc", 8))
    assert whole == early
    assert tolerated(early)


def test_a_run_that_fails_after_its_loss_is_judged_once_and_for_all(tmp_path, import_folder):
    """Its law raises when the arm is outside, within the time in which the reason is sought."""
    law = own_law(tmp_path, "if tracking.time_s > 0.25: raise ValueError('too late')", "late")
    _, early = rows_of(f"controller.law={law}", "robot.initial_offset_rad=0.4", *delayed(law, 0))
    assert early["verdict"] == "faulted"
    assert "too late" in early["error"]
    assert not left_nothing(early)
    assert not tolerated(early)


def test_spreads_over_early_rows_are_unknown_and_the_first_loss_is_the_worst():
    run = PlannedRun("p", "paper_arm", (), 1, {})
    kept = made_up(run, loss_reason=None)
    early, later = (
        made_up(run, violation_fraction=0.1)
        | {"violation_fraction": None, "rms_rad": None, "margin_min": None,
           "first_violation_s": time_s, "ended_early_s": time_s + 0.3}
        for time_s in (0.2, 0.4)
    )  # fmt: skip
    assert [is_whole(row) for row in (kept, early)] == [True, False]
    spread = spread_of_runs([kept, later, early])
    unknown = {"mean": None, "lowest": None, "highest": None}
    assert spread["violation_fraction"] == spread["margin_min"] == unknown
    assert spread["worst_rms_rad"] == unknown
    assert spread["first_violation_s"]["lowest"] == 0.2
    assert (spread["runs"], spread["runs_kept"]) == (3, 1)
    assert max([kept, later, early], key=badness) is early


def test_runs_that_end_before_a_command_acts_do_not_show_that_a_value_has_no_effect():
    run = PlannedRun("p", "paper_arm", (), 1, {"value": 1.0})
    rows = [made_up(run, violation_fraction=0.1, loss_reason="start") | {"value": value}
            for value in (1.0, 2.0)]  # fmt: skip
    assert without_effect(rows, [("value",)], ["value"]) == []
    others = [{**row, "loss_reason": "growing"} for row in rows]
    assert without_effect(others, [("value",)], ["value"]) == ["value"]


def test_a_margin_by_the_command_says_what_it_saved(funnel_hil, tmp_path):
    words = ["margin", "paper_arm", "--laws", "fixed_time_neural", "--limit", "8", "--duration",
             "3", "--resolution", "4", "--workers", "1"]  # fmt: skip
    funnel_hil.output(*words, "--out", tmp_path / "few")
    rows = read_rows(tmp_path / "few" / "margin.parquet")
    assert any(not is_whole(row) for row in rows)
    table = (tmp_path / "few" / "table.md").read_text(encoding="utf-8")
    assert "runs: 6 of 8 planned, 2 ended at their loss" in table
    funnel_hil.output(*words, "--exhaustive", "--out", tmp_path / "all")
    table = (tmp_path / "all" / "table.md").read_text(encoding="utf-8")
    assert "runs: 9 of 9 planned." in table
    assert all(map(is_whole, read_rows(tmp_path / "all" / "margin.parquet")))
    output = funnel_hil.output(*words, "--exhaustive", "--out", tmp_path / "few", code=2)
    assert "exhaustive = True: must be False" in output

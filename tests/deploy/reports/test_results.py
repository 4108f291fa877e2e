"""Results as classes: what is written is what is read."""

from __future__ import annotations

import json

import pytest

from deploy.reports.studies.study_result import Share
from deploy.reports.studies.study_tables import shown_columns
from deploy.reports.tables import number, table_of
from deploy.studies.benchmark.result import BenchmarkResult, CellResult, PlantsKept
from deploy.studies.datasheet.result import RobotRun, Way, WayResult
from deploy.studies.policy.result import Point
from deploy.studies.tune.result import Judged, TunedLaw, TuneResult

SHARE = {"kept": 3, "total": 4, "fraction": 0.75, "wilson_95": None}
CELL = CellResult(
    scenario="arm", law="pid", predictor="none", gains="given", margin_ms=8.0, any_pattern_ms=4.0,
    rms_rad=None, travel_nm_per_s=[1.0, 2.5], networks={"calm": Share(**SHARE)},
    plants_kept=[PlantsKept(round_trip_ms=8.0, **SHARE)],
)  # fmt: skip
LAW = TunedLaw(
    candidates=2, cost_start=1.0, cost_found=0.5, best_candidate=1, history=[1.0, 0.5],
    gained_in_last_quarter=0.5, spread=0.1, converged=False, gains={"start": {"k": [1.0]}},
    judged={"found": [Judged(place="bench", runs=2, kept=1, kept_up_to_ms=None)]},
)  # fmt: skip
RESULTS = [
    BenchmarkResult(kind="benchmark", plants=None, cells=[CELL]),
    TuneResult(kind="tune", travel_limit_per_s=None, laws={"pid": LAW}),
]


@pytest.mark.parametrize("result", RESULTS, ids=lambda each: each.kind)
def test_a_result_that_is_read_is_the_one_that_was_written(result):
    written = json.loads(json.dumps(result.to_json()))
    read = type(result).model_validate(written)
    assert read == result
    assert read.to_json() == written


def test_what_was_not_set_is_not_written_and_what_is_unknown_is_null():
    [written] = LAW.to_json()["judged"]["found"]
    assert written == {"place": "bench", "runs": 2, "kept": 1, "kept_up_to_ms": None}
    assert "file" not in LAW.to_json()
    assert CELL.to_json()["networks"] == {"calm": SHARE}


def test_columns_are_in_their_unit_and_empty_where_nothing_is_known():
    """1.5 mrad are 1.5e-3 rad; a share of 0.25 is 25 %."""
    figures = dict.fromkeys(
        ["jump_mm", "jerk_rad_s3", "jerk_rms_rad_s3", "age_median_ms", "age_largest_ms",
         "tip_error_rms_mm"]
    )  # fmt: skip
    point = Point(
        inference_ms=0.0, runs=1, runs_kept=1, ends=None, worst_point="0", jump_rad=1.5e-3,
        starved_share=0.25, **figures,
    )  # fmt: skip
    table = table_of("t", shown_columns(Point, lambda item: item), [point, None])
    named = dict(zip([each.title for each in table.columns], table.rows[0], strict=True))
    assert named["Largest jump (mrad)"] == pytest.approx(1.5)
    assert named["Waiting (%)"] == pytest.approx(25.0)
    assert named["At the tip (mm)"] is None
    assert set(table.rows[1]) == {None}
    assert number(named["Largest jump (mrad)"]) == "1.5"


def test_a_way_to_drive_a_robot_names_what_applies_to_it():
    assert Way(law="streaming", preview=False, limiter=True).text == (
        "streaming, without preview, with limiter"
    )
    assert [name for name, _ in WayResult.model_fields.items()][:4] == list(Way.model_fields)
    assert issubclass(RobotRun, Way)

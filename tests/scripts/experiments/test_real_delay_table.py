"""The table that sets virtual time beside a real delay."""

from __future__ import annotations

from pathlib import Path

import pytest

from deploy.scenario.yaml_files import ScenarioError
from scripts.experiments import real_delay
from scripts.experiments.real_delay import Outcome, Row, in_virtual_time, rows, table

COMPENSATED = ["controller.delay_compensation.enabled=true", "duration_s=1"]


def outcome(margin: float, stall_ms: float | None = 1.0, first_s: float | None = None) -> Outcome:
    round_trips = {"p50": 48.5, "p99": 48.8, "p99_9": 49.0, "max": 50.0}
    return Outcome(margin > 0, margin, first_s, round_trips, 48.7, 0.4, stall_ms, [])


def test_runs_that_were_held_up_are_counted_apart() -> None:
    real = [outcome(0.20), outcome(0.10), outcome(-0.5, 1.0, 0.16), outcome(-2.0, 31.0, 0.5)]
    line = table([Row(48.0, outcome(0.24, None), real)]).splitlines()[2]
    assert line == (
        "| 48 | kept | 24.0 % | 2 of 3 | 10.0 % (-50.0 %) | 0 of 1 | 48.50 / 48.80"
        " | 48.70 (0.40) | 0.16 |"
    )


def test_row_without_a_steady_run_says_so() -> None:
    line = table([Row(48.0, outcome(0.24, None), [outcome(-2.0, 31.0, 0.5)])]).splitlines()[2]
    assert line == "| 48 | kept | 24.0 % | 0 of 0 | – | 0 of 1 | – / – | – (–) | – |"


def test_virtual_time_has_the_same_round_trip_and_knows_the_horizon() -> None:
    found = in_virtual_time("paper_arm", COMPENSATED, 16.0)
    assert found.kept
    assert found.round_trip_ms["p50"] == pytest.approx(16.0)
    assert found.horizon_ms == pytest.approx(16.0)
    assert found.horizon_jitter_ms == pytest.approx(0.0)
    assert found.longest_stall_ms is None


def test_without_compensation_there_is_no_horizon() -> None:
    assert in_virtual_time("paper_arm", ["duration_s=1"], 2.0).horizon_ms is None


def test_refusal_comes_before_any_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(real_delay, "simulate", lambda _: pytest.fail("something was started"))
    with pytest.raises(ScenarioError, match="clock = 'lockstep'"):
        list(rows("paper_arm", ["clock=lockstep"], [8.0], 1, tmp_path))


@pytest.mark.serial
def test_row_of_one_short_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    patient = [*COMPENSATED, "plant.command_timeout_ms=20000"]  # a busy machine may stand still
    (row,) = rows("paper_arm", patient, [8.0], 1, tmp_path)
    assert row.virtual.kept
    assert row.real[0].round_trip_ms["p50"] >= 8.0
    assert (tmp_path / "8-ms-1" / "run.mcap").is_file()
    progress = capsys.readouterr().err.splitlines()
    assert progress[0].startswith("8 ms, virtual time: kept")
    assert progress[1].startswith("8 ms, run 1 of 1: ")

"""The table that sets virtual time beside a real delay."""

from __future__ import annotations

from pathlib import Path

import pytest

from deploy.scenario.yaml_files import ScenarioError
from scripts.experiments import real_delay
from scripts.experiments.real_delay import rows

COMPENSATED = ["controller.delay_compensation.enabled=true", "duration_s=1"]


def test_refusal_comes_before_any_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(real_delay, "execute", lambda _: pytest.fail("something was started"))
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

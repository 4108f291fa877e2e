from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from pyarrow import parquet

import funnel_hil as interface
from controller.laws import COMPARED_LAWS, LAWS
from controller.laws.fixed_time_model_based import FixedTimeModelBased
from controller.laws.pid import Pid
from controller.laws.sliding_mode import SlidingMode
from deploy.cli.parts.common import parse_laws
from deploy.judge.recorded_ticks import known_ticks
from deploy.judge.run_rows import row, write_rows
from deploy.reports.runs import run_panels
from deploy.run.run_folder import load_run
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError
from deploy.studies.comparison.comparison import LawComparison
from tests.damage import damage_at

SHORTLY = {"duration_s": 0.3, "metrics.from_s": 0.1}
SHORT = [word for key, value in SHORTLY.items() for word in ("--set", f"{key}={value}")]


@pytest.fixture(scope="module")
def comparison(funnel_hil, tmp_path_factory):
    """A comparison of two laws: exit code, output and folder."""
    folder = tmp_path_factory.mktemp("comparison")
    code, output = funnel_hil(
        "compare", "--laws", "pid, fixed_time_neural", *SHORT, "--out", folder
    )
    return code, output, folder


@pytest.fixture
def compared(comparison, tmp_path):
    """The same with a copy of the folder, to do with as a test likes."""
    code, output, folder = comparison
    return code, output, shutil.copytree(folder, tmp_path / "copy")


def test_all_registered_laws_are_compared_by_default():
    assert parse_laws(None) is None
    study = LawComparison({"scenario": "paper_arm"}, Path("compare"))
    assert [setup.scenario.controller.law for setup in study.variants] == COMPARED_LAWS


def test_laws_are_named_once_and_in_the_order_asked_for():
    assert parse_laws("smc, pid,smc ,,fixed_time_neural") == ["smc", "pid", "fixed_time_neural"]


@pytest.mark.parametrize("text", ["", " , "])
def test_no_law_at_all_is_refused_with_the_names_of_all(text):
    with pytest.raises(ScenarioError, match=", ".join(LAWS)):
        parse_laws(text)


def test_a_comparison_leaves_rows_summary_manifest_and_report(compared):
    code, output, folder = compared
    assert code == 0
    assert output.index("pid") < output.index("fixed_time_neural")
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["kind"] == "comparison"
    assert list(summary["laws"]) == ["pid", "fixed_time_neural"]
    manifest = json.loads((folder / "manifest.json").read_text())
    assert set(manifest["gains"]) == {"pid", "fixed_time_neural"}
    assert (folder / "report.html").stat().st_size > 10_000
    rows = parquet.read_table(folder / "comparison.parquet").to_pylist()
    assert [row["law"] for row in rows] == ["pid", "fixed_time_neural"]
    for one in rows:
        expected = summary["laws"][one["law"]]
        assert one["rms_rad"] == expected["tracking"]["rms_rad"]
        assert one["bounds_kept"] == expected["bounds"]["kept"]
        assert one["digest"] == expected["digest"]
        assert one["error"] is None
        assert len(one["total_variation_nm_per_s"]) == 3


def test_report_renders_a_comparison_again_from_its_recordings(compared, funnel_hil):
    _, _, folder = compared
    before = json.loads((folder / "summary.json").read_text())
    manifest = (folder / "manifest.json").read_bytes()
    (folder / "report.html").unlink()
    (folder / "comparison.parquet").unlink()
    output = funnel_hil.output("report", folder)
    assert "fixed_time_neural" in output
    assert json.loads((folder / "summary.json").read_text()) == before
    assert (folder / "manifest.json").read_bytes() == manifest
    assert (folder / "report.html").is_file()
    assert parquet.read_table(folder / "comparison.parquet").num_rows == 2


def test_damaged_recording_is_reported_with_its_missing_parts(compared, funnel_hil):
    _, _, folder = compared
    damage_at(folder / "fixed_time_neural" / "run.mcap", 100_000_000)
    code, output = funnel_hil("report", folder)
    data, _ = load_run(folder / "fixed_time_neural")
    assert code == 1
    assert data.damage
    words = [line.split() for line in output.splitlines()]
    assert ["fixed_time_neural", "unknown"] in [each[:2] for each in words]
    text = " ".join(output.split())
    assert f"fixed_time_neural: The recording is damaged: {'; '.join(data.damage)}." in text
    known = f"{known_ticks(data).known} of 300 ticks"
    assert f"fixed_time_neural: The true motion is known at {known}" in text
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "1 did not finish or cannot be read completely" in page
    inside = f"inside its bounds at the {known} at which it is known"
    assert f"fixed_time_neural: {inside}" in page


def test_a_comparison_without_its_recordings_is_refused(compared, funnel_hil):
    _, _, folder = compared
    (folder / "pid" / "run.mcap").unlink()
    output = funnel_hil.output("report", folder, code=2)
    assert "has no run.mcap" in output


def test_a_law_that_fails_is_a_row_with_its_error(monkeypatch, tmp_path):
    def fail(law, failing):
        working = law.torque

        def torque(law, tracking):
            return failing() if tracking.time_s >= 0.1 else working(law, tracking)

        monkeypatch.setattr(law, "torque", torque)

    fail(Pid, lambda: np.full(3, np.nan))
    fail(SlidingMode, lambda: np.zeros(2))
    fail(FixedTimeModelBased, lambda: [][1])
    laws = ["pid", "smc", "fixed_time_model_based", "fixed_time_neural"]
    interface.compare("paper_arm", SHORTLY, laws=laws, out=tmp_path)
    *failed, last = parquet.read_table(tmp_path / "comparison.parquet").to_pylist()
    for one, reason in zip(failed, ("nan", "shape", "IndexError"), strict=True):
        assert reason in one["error"]
        assert not one["completed"]
    assert last["error"] is None
    assert last["completed"]
    assert "3 did not finish" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_settling_from_near_and_far_is_kept_and_judged_again(funnel_hil, tmp_path, monkeypatch):
    panels = [panel for panel in run_panels.LAW_PANELS if panel.id == "settling-from-afar"]
    monkeypatch.setattr(run_panels, "LAW_PANELS", panels)
    short = ["--set", "duration_s=0.05", "--set", "metrics.from_s=0.01"]
    words = ["compare", "--laws", "pid", "--settling", *short, "--out", tmp_path]
    output = funnel_hil.output(*words)
    assert "of 9 starts of up to 1 rad" in output
    starts = json.loads((tmp_path / "summary.json").read_text())["settling"]
    assert [len(test["starts"]) for test in starts] == [9]
    assert funnel_hil("report", tmp_path)[0] == 0
    assert json.loads((tmp_path / "summary.json").read_text())["settling"] == starts
    assert 'id="settling-from-afar"' in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_bounds_are_required_of_every_law_compared(funnel_hil, tmp_path, monkeypatch):
    monkeypatch.setattr(run_panels, "LAW_PANELS", [])
    narrow = ["--set", "funnel.rate_per_s=200", "--require-bounds"]
    funnel_hil.output("compare", "--laws", "pid", *SHORT, *narrow, "--out", tmp_path, code=3)


def test_rows_of_runs_with_and_without_bounds_share_their_columns(tmp_path):
    from deploy.judge.metrics import RunResult, summarise

    setup = load_setup("paper_arm", ["duration_s=0.1", "controller.law=pid"])
    summary = summarise(simulate(setup).data())
    rows = []
    for bound in (None, 1.5):
        summary["tracking"]["settling_bound_s"] = bound
        rows.append(row(RunResult(**summary), seed=7))
    write_rows(rows, tmp_path / "rows.parquet")
    read = parquet.read_table(tmp_path / "rows.parquet").to_pylist()
    assert [r["settling_bound_s"] for r in read] == [None, [1.5] * 3]
    assert [r["seed"] for r in read] == [7, 7]

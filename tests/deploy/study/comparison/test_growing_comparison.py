"""A comparison grows by laws in its folder: what is there is not run again."""

from __future__ import annotations

import json

import pytest
from pyarrow import parquet

import funnel_hil as interface
from deploy.run.run_folder import read_summary
from deploy.study.planned_run import row_of
from funnel_hil import studies


@pytest.fixture
def tried(monkeypatch):
    """Laws that were simulated, in this process."""
    laws = []

    def watched(run):
        laws.append(run.columns["law"])
        return row_of(run)

    monkeypatch.setattr(studies, "row_of", watched)
    return laws


def compare(out, laws, *, overwrite=False, **changes):
    changes = {"duration_s": 0.2, "metrics.from_s": 0, **changes}
    return interface.compare("paper_arm", changes, laws=laws, out=out, overwrite=overwrite)


def table_of(path):
    return parquet.read_table(path / "comparison.parquet").to_pylist()


def test_it_grows_by_laws_and_is_that_made_at_once(tmp_path, tried):
    out = tmp_path / "grown"
    compare(out, ["smc"])
    compare(out, ["pid", "smc", "tsmc"])
    assert tried == ["smc", "pid", "tsmc"]
    at_once = compare(tmp_path / "whole", ["pid", "smc", "tsmc"])
    assert table_of(out) == table_of(tmp_path / "whole")
    assert [row["law"] for row in at_once.rows] == ["pid", "smc", "tsmc"]
    assert list(read_summary(out)["laws"]) == ["pid", "smc", "tsmc"]
    page = (out / "report.html").read_text()
    assert all(law in page for law in ("pid", "smc", "tsmc"))
    assert json.loads((out / "manifest.json").read_text())["laws"] == ["pid", "smc", "tsmc"]


def test_command_adds_laws_and_settling_times_on_its_workers(tmp_path, funnel_hil):
    out = tmp_path / "laws"
    short = ["--set", "duration_s=0.05", "--set", "metrics.from_s=0"]
    assert funnel_hil("compare", "--laws", "smc", *short, "--out", out)[0] == 0
    words = ["compare", "--laws", "smc,pid", "--settling", *short, "--out", out]
    output = funnel_hil.output(*words)
    assert "1 runs were there from before" in output
    assert "pid: settled from" in output
    # Nine starts for each law; those of a row alone have no recording.
    assert len(table_of(out)) == 20
    assert sorted(each.parent.name for each in out.rglob("run.mcap")) == ["pid", "smc"]


def test_a_run_without_its_recording_is_made_again(tmp_path, tried):
    out = tmp_path / "laws"
    compare(out, ["smc", "pid"])
    (out / "pid" / "run.mcap").unlink()
    compare(out, ["smc", "pid"])
    assert tried == ["smc", "pid", "pid"]


def test_overwriting_makes_every_run_again(tmp_path, tried):
    for _ in range(2):
        compare(tmp_path / "laws", ["smc"], overwrite=True)
    assert tried == ["smc", "smc"]


def test_a_comparison_that_was_killed_goes_on(tmp_path, tried, funnel_hil):
    out = tmp_path / "laws"
    compare(out, ["smc"])
    for name in ("summary.json", "report.html"):
        (out / name).unlink()
    compared = compare(out, ["smc", "pid"])
    assert tried == ["smc", "pid"]
    assert list(compared.runs) == ["smc", "pid"]
    (out / "summary.json").unlink()
    funnel_hil.output("report", out)
    assert list(read_summary(out)["laws"]) == ["smc", "pid"]


@pytest.mark.parametrize(
    ("laws", "changes", "message"),
    [
        (["smc"], {"seed": 9}, r"seeds = \[9\]: must have all of \[1\]"),
        (["smc"], {"duration_s": 0.3}, "has changed"),
        (["pid"], {}, r"laws = \['pid'\]: must have all of \['smc'\]"),
    ],
)
def test_another_scenario_is_refused(laws, changes, message, tmp_path, tried):
    out = tmp_path / "laws"
    compare(out, ["smc"])
    before = (out / "summary.json").read_text()
    with pytest.raises(interface.InputError, match=message):
        compare(out, laws, **changes)
    assert tried == ["smc"]
    assert (out / "summary.json").read_text() == before
    compare(out, laws, overwrite=True, **changes)

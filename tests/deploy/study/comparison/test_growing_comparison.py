"""A comparison grows by laws in its folder: what is there is not run again."""

from __future__ import annotations

import json

import pytest
from pyarrow import parquet

import funnel_hil as interface
from deploy.run.execute import execute
from deploy.run.run_folder import read_summary
from deploy.study.comparison import comparison

SHORT = ("--set", "duration_s=0.2", "--set", "metrics.from_s=0")


@pytest.fixture
def tried(monkeypatch):
    """Laws that were simulated."""
    laws = []

    def watched(setup, *words):
        laws.append(setup.scenario.controller.law)
        return execute(setup, *words)

    monkeypatch.setattr(comparison, "execute", watched)
    return laws


def table_of(path):
    return parquet.read_table(path / "comparison.parquet").to_pylist()


def test_it_grows_by_laws_and_is_that_made_at_once(tmp_path, funnel_hil, tried):
    out = tmp_path / "grown"
    assert funnel_hil("compare", "--laws", "smc", *SHORT, "--out", out)[0] == 0
    code, said = funnel_hil("compare", "--laws", "pid,smc,tsmc", *SHORT, "--out", out)
    assert code == 0, said
    assert tried == ["smc", "pid", "tsmc"]
    assert "(from before)" in said
    assert funnel_hil("compare", "--laws", "pid,smc,tsmc", *SHORT, "--out", tmp_path / "w")[0] == 0
    assert table_of(out) == table_of(tmp_path / "w")
    assert list(read_summary(out)["laws"]) == ["pid", "smc", "tsmc"]
    page = (out / "report.html").read_text()
    assert all(law in page for law in ("pid", "smc", "tsmc"))
    assert json.loads((out / "manifest.json").read_text())["laws"] == ["pid", "smc", "tsmc"]


def test_a_run_that_came_to_no_end_is_made_again(tmp_path, funnel_hil, tried):
    out = tmp_path / "laws"
    funnel_hil("compare", "--laws", "smc,pid", *SHORT, "--out", out)
    summary = json.loads((out / "smc" / "summary.json").read_text())
    (out / "smc" / "summary.json").write_text(json.dumps(summary | {"completed": False}))
    (out / "pid" / "run.mcap").unlink()
    assert funnel_hil("compare", "--laws", "smc,pid", *SHORT, "--out", out)[0] == 0
    assert tried == ["smc", "pid"] * 2


def test_overwriting_makes_every_run_again(tmp_path, funnel_hil, tried):
    for _ in range(2):
        words = ("compare", "--laws", "smc", *SHORT, "--out", tmp_path / "laws", "--overwrite")
        assert funnel_hil(*words)[0] == 0
    assert tried == ["smc", "smc"]


def test_a_comparison_that_was_killed_goes_on(tmp_path, funnel_hil, tried):
    out = tmp_path / "laws"
    funnel_hil("compare", "--laws", "smc,pid", *SHORT, "--out", out)
    before = table_of(out)
    for name in ("summary.json", "comparison.parquet", "report.html", "pid/summary.json"):
        (out / name).unlink()
    assert funnel_hil("compare", "--laws", "smc,pid", *SHORT, "--out", out)[0] == 0
    assert tried == ["smc", "pid", "pid"]
    assert table_of(out) == before
    (out / "summary.json").unlink()
    code, said = funnel_hil("compare", "--laws", "smc,pid", "--set", "seed=9", "--out", out)
    assert code == 2
    assert "duration_s, metrics.from_s, seed: must be the same" in said


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["smc", *SHORT, "--set", "seed=9"], "(smc): seed: must be the same"),
        (["smc", "--set", "duration_s=0.3", *SHORT[2:]], "duration_s: must be the same"),
        (["pid", *SHORT], "holds a comparison with smc: must be among --laws"),
    ],
)
def test_another_scenario_is_refused_by_its_keys(words, said, tmp_path, funnel_hil, tried):
    out = tmp_path / "laws"
    funnel_hil("compare", "--laws", "smc", *SHORT, "--out", out)
    before = (out / "summary.json").read_text()
    code, told = funnel_hil("compare", "--laws", *words, "--out", out)
    assert code == 2
    assert said in told
    assert tried == ["smc"]
    assert (out / "summary.json").read_text() == before
    assert funnel_hil("compare", "--laws", *words, "--out", out, "--overwrite")[0] == 0


def test_from_python(tmp_path):
    changes = {"duration_s": 0.2}
    interface.compare("paper_arm", changes, laws=["smc"], out=tmp_path / "laws")
    grown = interface.compare("paper_arm", changes, laws=["smc", "pid"], out=tmp_path / "laws")
    at_once = interface.compare("paper_arm", changes, laws=["smc", "pid"])
    assert grown.rows == at_once.rows

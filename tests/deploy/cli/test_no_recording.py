"""A path that is no recorded run: the message names what it is, and where runs are."""

from __future__ import annotations

import pytest

from bus_schema.recording.atomic_files import write_json


@pytest.fixture
def runs(tmp_path, monkeypatch):
    """Results of each kind, as far as they are looked at."""
    monkeypatch.chdir(tmp_path)
    for name, kind in (
        ("paper_arm-1", "run"), ("margin-a", "margin"), ("sweep-a", "sweep"), ("both", "comparison")
    ):  # fmt: skip
        (tmp_path / "runs" / name).mkdir(parents=True)
        write_json(tmp_path / "runs" / name / "summary.json", {"kind": kind})
    (tmp_path / "runs" / "both" / "pid").mkdir()
    (tmp_path / "runs" / "both" / "pid" / "run.mcap").touch()
    (tmp_path / "runs" / "under_way").mkdir()
    (tmp_path / "runs" / "under_way" / "study.yaml").touch()
    return tmp_path / "runs"


COMMANDS = (("view",), ("replay",), ("export", "--csv"))


@pytest.mark.parametrize("command", COMMANDS)
def test_folder_that_is_not_there(funnel_hil, runs, command):
    output = funnel_hil.output(*command, "runs/papr_arm-1", code=2)
    assert "error: runs/papr_arm-1: has no run.mcap: no such folder or file; " in output
    assert "funnel-hil runs list runs shows runs/both, runs/margin-a, runs/paper_arm-1, " in output
    assert output.endswith("; did you mean paper_arm-1?\n")


@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("margin-a", "margin"),
        ("sweep-a", "sweep"),
        ("under_way", "study"),
        ("both", "comparison, with runs in runs/both/pid"),
    ],
)
def test_results_of_another_kind(funnel_hil, runs, name, what):
    output = funnel_hil.output("view", f"runs/{name}", code=2)
    reported = f"has no run.mcap, because it is not a run but has results of kind {what}"
    assert output == f"error: runs/{name}: {reported}; funnel-hil report runs/{name} shows them\n"


def test_folder_of_a_run_without_its_recording(funnel_hil, runs):
    output = funnel_hil("view", "runs/paper_arm-1")[1]
    assert output == "error: runs/paper_arm-1: has no run.mcap\n"

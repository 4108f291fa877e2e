"""A margin that fell ends a command with 3, and leaves what CI services read."""

from __future__ import annotations

import json
import shutil
import subprocess
import xml.etree.ElementTree as ET

import pytest

import funnel_hil as interface
from deploy.reports.gate import Entry, Gate, Gauged, build_gate, gauged, since_when
from deploy.scenario.yaml_files import ScenarioError
from tests.warm_process import ROOT

SHORT = ["--set", "duration_s=0.2", "--set", "metrics.from_s=0.1"]
EXAMPLE = ROOT / "deploy/docs/examples/margin-gate"


def delay(value, name="arm, law"):
    return Gauged(name, value, "ms")


@pytest.mark.parametrize(
    ("found", "at_least", "fails"),
    [(20.0, "20ms", False), (19.5, "20ms", True), (None, "0", True), (20.0, "20", False)],
)
def test_margin_must_reach_the_limit(found, at_least, fails):
    assert bool(build_gate(at_least, None, None).failures([delay(found)])) == fails


@pytest.mark.parametrize(
    ("before", "after", "fails"),
    [(20.0, 19.0, False), (20.0, 18.9, True), (20.0, 30.0, False), (20.0, None, True),
     (None, None, False)],
)  # fmt: skip
def test_margin_may_fall_by_the_tolerance(before, after, fails):
    gate = Gate(baseline={"arm, law": delay(before)}, tolerance=1.0)
    assert bool(gate.failures([delay(after)])) == fails


def test_quantity_that_is_better_when_smaller_must_not_grow():
    gate = Gate(baseline={"rate": Gauged("rate", 100.0, "Hz", -1)}, tolerance=10.0)
    assert not gate.failures([Gauged("rate", 110.0, "Hz", -1)])
    assert gate.failures([Gauged("rate", 111.0, "Hz", -1)])


def test_case_that_the_baseline_has_must_be_there():
    gate = Gate(baseline={"arm, law": delay(20.0)})
    assert gate.failures([delay(20.0, "arm, other")]) == {"arm, law": "arm, law: is missing"}


def test_sentence_names_what_fell_by_how_much_and_since_when():
    gate = Gate(baseline={"arm, law": delay(20.0)}, tolerance=1.0)
    fell = delay(15.0)
    said = gate.failures([fell])["arm, law"]
    assert said == "arm, law: fell by 5 from 20 ms to 15 ms, more than the 1 ms allowed"
    values = {"a": 20.0, "b": 21.0, "c": 15.0}
    entries = [Entry(commit, "", {"arm, law": value}) for commit, value in values.items()]
    assert since_when(entries, fell) == "; it was 21 at b, and fell at c"
    assert since_when(entries[2:], fell) == ""


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["simulate", "--at-least", "20ms"], "unit 'ms': must be %"),
        (["margin", "--at-least", "20%"], "unit '%': must be ms"),
        (["margin", "--at-least", "much"], "--at-least 'much': must be a number"),
        (["sweep", "delay_sweep", "--tolerance", "1%"], "needs --baseline"),
        (["compare", "--baseline", "nowhere.json"], "must be summary.json of a run or study"),
    ],
)
def test_gate_that_fits_no_result_is_refused_before_anything_runs(
    words, said, funnel_hil, tmp_path
):
    code, told = funnel_hil(*words, "--out", tmp_path / "out")
    assert code == 2
    assert said in told
    assert not (tmp_path / "out").exists()


def test_commands_end_with_3_and_leave_files_for_ci(funnel_hil, tmp_path, monkeypatch):
    monkeypatch.setenv("GITHUB_SHA", "0123456789abcdef")
    files = ["--junit", tmp_path / "j.xml", "--markdown", tmp_path / "m.md",
             "--history", tmp_path / "history"]  # fmt: skip
    simulate = ["simulate", *SHORT, "--no-report", *files]
    assert funnel_hil(*simulate, "--at-least", "10%", "--out", tmp_path / "1")[0] == 0
    code, said = funnel_hil(*simulate, "--at-least", "99%", "--out", tmp_path / "2")
    assert code == 3
    assert "must be at least 99 % of the bound" in said
    suite = ET.parse(tmp_path / "j.xml").getroot()
    assert suite.get("failures") == "1"
    assert "99 %" in suite.find("testcase/failure").get("message")
    assert "| paper_arm, fixed_time_neural | 34.25 % of the bound |" in (
        (tmp_path / "m.md").read_text()
    )
    entries = (tmp_path / "history" / "history.jsonl").read_text().splitlines()
    assert [json.loads(entry)["commit"] for entry in entries] == ["01234567"] * 2
    assert "history over commits" not in (tmp_path / "history" / "history.html").read_text()
    code, said = funnel_hil(
        "compare", "--laws", "pid", "--set", "funnel.rate_per_s=200", *SHORT,
        "--baseline", tmp_path / "1", "--out", tmp_path / "3",
    )  # fmt: skip
    assert code == 3
    assert "paper_arm, fixed_time_neural: is missing" in said


def test_numbers_of_studies_are_margins_and_distances_to_the_bound():
    short = {"duration_s": 0.2, "metrics.from_s": 0.1}
    margin = interface.margin("paper_arm", short, laws=["smc"], resolution=16, limit=16)
    assert [each.unit for each in gauged(margin.summary)] == ["ms"]
    grid = {"controller.law": ["smc", "pid"]}
    sweep = interface.sweep("paper_arm", grid, short)
    assert [each.name for each in gauged(sweep.summary)] == [
        "controller.law = smc", "controller.law = pid"
    ]  # fmt: skip
    kept = {row["law"]: row["margin_min"] for row in sweep.rows}
    assert gauged(sweep.summary)[0].value == pytest.approx(100 * kept["smc"])


def test_damaged_history_is_refused(tmp_path, funnel_hil):
    (tmp_path / "history.jsonl").write_text('{"commit": 1}\n')
    code, said = funnel_hil("simulate", *SHORT, "--history", tmp_path, "--out", tmp_path / "out")
    assert code == 2
    assert "history.jsonl, line 1: must be an entry" in said


@pytest.mark.parametrize(("change", "code"), [("", 0), ("stiffness=400.0 stiffness=2000.0", 3)])
def test_example_repository_passes_until_its_law_gets_worse(change, code, tmp_path):
    folder = shutil.copytree(EXAMPLE, tmp_path / "example")
    law = folder / "my_laws.py"
    law.write_text(law.read_text().replace(*(change.split() or ["", ""])))
    program = ROOT / ".venv/bin"
    done = subprocess.run(
        ["./gate.sh"], cwd=folder, env={"PATH": f"{program}:/usr/bin:/bin"},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == code, done.stdout + done.stderr


def test_number_without_unit_and_unit_of_tolerance_must_agree(tmp_path):
    (tmp_path / "summary.json").write_text("{}")
    with pytest.raises(ScenarioError, match="must have the unit of --at-least, ms"):
        build_gate("20ms", tmp_path, "1%")

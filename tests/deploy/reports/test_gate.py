"""A margin that fell ends a command with 3, and leaves what CI services read."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import xml.etree.ElementTree as ET
from multiprocessing import get_context
from pathlib import Path

import pytest

import funnel_hil as interface
from deploy.judge.gate import (
    Entry,
    Gate,
    Gauged,
    build_gate,
    locked_history,
    read_history,
    since_when,
)  # fmt: skip
from deploy.judge.tested_with import require_same_test
from deploy.judge.tested_with import tested_with as conditions_of
from deploy.reports.gate_files import write_history, write_junit, write_markdown
from deploy.reports.kinds import gauged
from deploy.scenario.referenced_files import ROBOTS
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError
from deploy.studies.margin.margin import Margin
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
    assert bool(build_gate(at_least, None).failures([delay(found)])) == fails


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
    text = gate.failures([fell])["arm, law"]
    assert text == "arm, law: fell by 5 from 20 ms to 15 ms, more than the 1 ms allowed"
    values = {"a": 20.0, "b": 21.0, "c": 15.0}
    entries = [Entry(commit, "", {"arm, law": value}) for commit, value in values.items()]
    assert since_when(entries, fell) == "; it was 21 at b, and fell at c"
    assert since_when(entries[2:], fell) == ""


def test_commands_end_with_3_and_leave_files_for_ci(funnel_hil, tmp_path, monkeypatch):
    monkeypatch.setenv("GITHUB_SHA", "0123456789abcdef")
    files = ["--junit", tmp_path / "j.xml", "--markdown", tmp_path / "m.md",
             "--history", tmp_path / "history"]  # fmt: skip
    simulate = ["simulate", *SHORT, "--no-report", *files]
    assert funnel_hil(*simulate, "--at-least", "10%", "--out", tmp_path / "1")[0] == 0
    output = funnel_hil.output(*simulate, "--at-least", "99%", "--out", tmp_path / "2", code=3)
    assert "must be at least 99 % of the bound" in output
    suite = ET.parse(tmp_path / "j.xml").getroot()
    assert suite.get("failures") == "1"
    assert "99 %" in suite.find("testcase/failure").get("message")
    assert "| paper_arm, fixed_time_neural | 34.25 % of the bound |" in (
        (tmp_path / "m.md").read_text()
    )
    entries = (tmp_path / "history" / "history.jsonl").read_text().splitlines()
    assert [json.loads(entry)["commit"] for entry in entries] == ["01234567"] * 2
    assert "history over commits" not in (tmp_path / "history" / "history.html").read_text()
    output = funnel_hil.output(
        "compare", "--laws", "pid", *SHORT,
        "--baseline", tmp_path / "1", "--out", tmp_path / "3", code=3)  # fmt: skip
    assert "paper_arm, fixed_time_neural: is missing" in output


def test_tip_error_is_gated_by_a_limit_in_millimetres(funnel_hil, tmp_path):
    simulate = ["simulate", *SHORT, "--no-report"]
    output = funnel_hil.output(*simulate, "--at-least", "500mm", "--out", tmp_path / "1")
    rms, largest = re.search(
        r"tip was off by ([\d.]+) mm RMS, ([\d.]+) mm at most", output
    ).groups()
    summary = json.loads((tmp_path / "1" / "summary.json").read_text())
    tip = summary["tip_error_mm"]
    assert (tip["rms"], tip["largest"]) == pytest.approx((float(rms), float(largest)), rel=0.01)
    assert 0.0 < tip["rms"] < tip["largest"]
    limit = f"{0.99 * tip['largest']:.6f}mm"
    output = funnel_hil.output(*simulate, "--at-least", limit, "--out", tmp_path / "2", code=3)
    assert "paper_arm, fixed_time_neural, largest tip error: " in output
    assert f"must be at most {0.99 * tip['largest']:g} mm" in output
    baseline = ["--baseline", tmp_path / "1", "--tolerance", "0.5mm"]
    assert funnel_hil(*simulate, *baseline, "--out", tmp_path / "3")[0] == 0
    worse = ["--set", "plant.payload_kg=20", "--allow-changes", *baseline]
    output = funnel_hil.output(*simulate, *worse, "--out", tmp_path / "4", code=3)
    assert "largest tip error: rose by" in output
    (tmp_path / "old.json").write_text(json.dumps(summary | {"tip_error_mm": None}))
    old = ["--baseline", tmp_path / "old.json", "--tolerance", "1mm"]
    output = funnel_hil.output(*simulate, *old, "--out", tmp_path / "5", code=2)
    assert "has no number in mm" in output
    assert [each.unit for each in gauged(summary)] == ["% of the bound"]


def test_lag_is_gated_by_a_limit_in_milliseconds(funnel_hil, tmp_path):
    """20 + 8 ms, and half a cycle of 4; friction holds up the elbow."""
    simulate = [
        "simulate", "--no-report", "--set", "plant.interface.kind=rsi", "--set",
        "controller.law=streaming", "--set", "controller.preview_ms=0", "--set", "duration_s=1",
        "--set", "plant.interface.rsi={dead_time_ms: 8, lag_ms: 0}", "--set",
        "link.downlink.delay_ms=20", "--set", "robot.initial_offset_rad=0", "--set",
        "funnel={final_rad: 1, convergence_margin_rad: 2, overshoot_margin_rad: 2}",
    ]  # fmt: skip
    assert funnel_hil(*simulate, "--at-least", "50ms", "--out", tmp_path / "1")[0] == 0
    output = funnel_hil.output(*simulate, "--at-least", "25ms", "--out", tmp_path / "2", code=3)
    assert "paper_arm, streaming, largest lag: 3" in output
    assert "must be at most 25 ms" in output
    summary = json.loads((tmp_path / "1" / "summary.json").read_text())
    [lag] = gauged(summary, "ms")
    assert lag.value == max(summary["lag_ms"])
    assert summary["lag_ms"][0] == pytest.approx(30.0, abs=1.0)
    lost = {**summary, "verdict": "lost"}
    assert [each.value for each in gauged(lost, "ms")] == [None]


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


def test_number_without_unit_and_unit_of_tolerance_must_agree():
    with pytest.raises(ScenarioError, match="must have the unit of --at-least, ms"):
        build_gate("20ms", "1s", ("runs", []))


@pytest.mark.parametrize(
    ("before", "after", "fails"),
    [
        (Gauged("a", 20.0, "ms"), 16.0, False),
        (Gauged("a", 20.0, "ms"), 15.5, True),
        (Gauged("a", 100.0, "Hz", -1), 120.0, False),
        (Gauged("a", 100.0, "Hz", -1), 121.0, True),
        (Gauged("a", 0.0, "ms"), -0.5, True),
        (Gauged("a", 50.0, "% of the bound"), 30.0, False),  # percent of the bound, as the number
        (Gauged("a", 50.0, "% of the bound"), 29.0, True),
    ],
)
def test_tolerance_in_percent_is_a_share_of_the_earlier_number(before, after, fails):
    gate = build_gate(None, "20%", ("runs", [before]))
    failures = gate.failures([Gauged("a", after, before.unit, before.sign)])
    assert bool(failures) == fails
    if fails:
        assert "more than the 20 %" in failures["a"]


EASIER = {
    "funnel.overshoot_margin_rad=0.4": "funnel.overshoot_margin_rad = 0.03 before, 0.4 now",
    "duration_s=0.01": "duration_s = 0.2 before, 0.01 now",
    "robot.initial_offset_rad=0": "robot.initial_offset_rad = [0.15, -0.12, 0.1] before, [0.0] now",
    "rate_hz=2000": "rate_hz = 1000.0 before, 2000.0 now",
    "seed=2": "seeds = [1] before, [2] now",
    "plant.physics.integrator=runge_kutta_4": "semi_implicit_euler' before, 'runge_kutta_4' now",
    "reference.speed=0.5": "reference.speed = 1.0 before, 0.5 now",
    "plant.friction.viscous_nm_s=0": "plant.friction.viscous_nm_s = [10.0, 8.0, 5.0] before",
    "controller.model_scale=1.0": "controller.model_scale = 0.9 before, 1.0 now",
    "metrics.from_s=0.15": "metrics.from_s = 2.0 before, 0.15 now",  # errors of a tip are from then
}
SUBJECT = ["controller.law=pid", "controller.delay_compensation.enabled=true",
           "controller.torque_rate_limit_nm_s=1000"]  # fmt: skip


def values_of_test(*overrides):
    setup = load_setup("paper_arm", ["plant.physics.engine=mujoco", "duration_s=0.2", *overrides])
    return json.loads(json.dumps(conditions_of([setup], {"seeds": [setup.scenario.seed]})))


@pytest.mark.parametrize("change", SUBJECT)
def test_subject_of_a_test_may_change(change):
    assert require_same_test(values_of_test(), values_of_test(change), allows_changes=False) == []


@pytest.mark.parametrize("change", EASIER)
def test_test_that_became_easier_is_refused_and_named(change):
    with pytest.raises(ScenarioError, match="must have the same test") as refused:
        require_same_test(values_of_test(), values_of_test(change), allows_changes=False)
    assert EASIER[change] in str(refused.value)
    (found,) = require_same_test(values_of_test(), values_of_test(change), allows_changes=True)
    assert EASIER[change] in found


def test_arm_with_other_contents_is_another_test_and_a_moved_file_is_not(tmp_path):
    text = (ROBOTS / "paper_arm.urdf").read_text()
    for name, mass in (("copy", "15.612"), ("light", "7.8")):
        (tmp_path / f"{name}.urdf").write_text(text.replace('"15.612"', f'"{mass}"'))
    before, same, other = (
        values_of_test(f"robot.urdf={each}")
        for each in ("paper_arm", tmp_path / "copy.urdf", tmp_path / "light.urdf")
    )
    assert require_same_test(before, same, allows_changes=False) == []
    (found,) = require_same_test(before, other, allows_changes=True)
    assert found == "paper_arm: robot.urdf: the file or its arguments changed"


def test_command_refuses_a_baseline_of_another_test_or_lists_the_differences(funnel_hil, tmp_path):
    """For a margin: fewer starts, an easier limit; no process starts."""
    words = ["margin", "paper_arm", "--laws", "smc", "--limit", "4", "--resolution", "2",
             "--duration", "0.2"]  # fmt: skip
    before = tmp_path / "before"
    assert funnel_hil(*words, "--out", before)[0] == 0
    easier = [*words, "--offsets", "1", "--baseline", before, "--out", tmp_path / "new"]
    output = funnel_hil.output(*easier, code=2)
    assert "error: --baseline: offsets = [1.0, -0.5] before, [1.0] now: must have" in output
    assert not (tmp_path / "new").exists()
    output = funnel_hil.output(*easier, "--allow-changes", code=3)  # too short to be tested
    assert "gate: failed; --baseline: offsets = [1.0, -0.5] before, [1.0] now" in output
    summary = json.loads((before / "summary.json").read_text())
    del summary["tested_with"]
    (tmp_path / "old.json").write_text(json.dumps(summary))
    old = [*words, "--baseline", tmp_path / "old.json", "--out", tmp_path / "newer"]
    assert "does not say how it was tested" in funnel_hil.output(*old, code=2)
    assert "does not say how it was tested" in funnel_hil.output(*old, "--allow-changes", code=3)
    assert "--allow-changes: needs --baseline" in funnel_hil.output(
        *words, "--allow-changes", code=2
    )


def test_report_takes_the_test_of_a_run_from_its_manifest(funnel_hil, tmp_path):
    """Which has it since the run; the recording has the arm in other words than its file."""
    out = tmp_path / "out"
    funnel_hil("simulate", "paper_arm", *SHORT, "--no-report", "--out", out)
    manifest, summary = (out / f"{name}.json" for name in ("manifest", "summary"))
    kept = json.loads(manifest.read_text())
    assert kept["tested_with"]["paper_arm"]["robot.urdf"]
    assert json.loads(summary.read_text())["tested_with"] == kept["tested_with"]
    kept["tested_with"]["study"]["seeds"] = [7]
    manifest.write_text(json.dumps(kept))
    funnel_hil("report", out)
    assert json.loads(summary.read_text())["tested_with"] == kept["tested_with"]


def test_margin_that_leaves_unknowns_out_is_another_test():
    tests = [
        Margin({"laws": ["smc"], **more}, Path("margin")).tested_with
        for more in ({"model_errors": [0.8]}, {})
    ]
    (found,) = require_same_test(*tests, allows_changes=True)
    assert found == "unknowns = ['model masses × 0.8'] before, null now"


MARGIN = json.loads((EXAMPLE / "baseline.json").read_text())
(CASE,) = MARGIN["cases"]
RUN = {"scenario": "a", "law": "b", "verdict": "kept", "completed": True,
       "bounds": {"margin_min": 0.5}}  # fmt: skip
POINT = {"values": [1], "runs": 1, "runs_kept": 1, "margin_min": {"lowest": 0.1}}
MALFORMED = {
    "empty": ("", "Invalid JSON"),
    "no JSON": ("{", "Invalid JSON"),
    "a list": ("[]", "must be summary.json"),
    "deep": ("[" * 100_000, "recursion limit"),
    "binary": (b"\xff\xfe", "no text in UTF-8"),
    "another kind": ({"kind": "diff"}, "'diff'"),
    "kind of a wrong type": ({"kind": []}, "must be summary.json"),
    "nothing": ({}, "scenario"),
    "no bounds": ({**RUN, "bounds": None}, "bounds"),
    "margin is text": ({**RUN, "bounds": {"margin_min": "0.5"}}, "bounds.margin_min"),
    "margin is NaN": (json.dumps({**RUN, "bounds": {"margin_min": float("nan")}}), "margin_min"),
    "unfinished": ({**RUN, "completed": False}, "is unfinished"),
    "no cases": ({**MARGIN, "cases": []}, "cases"),
    "cases are numbers": ({**MARGIN, "cases": [1]}, "cases.0"),
    "margin of a study is NaN": (
        json.dumps({**MARGIN, "cases": [{**CASE, "margin": float("nan")}]}), "cases.0.margin"
    ),
    "no margin": ({**MARGIN, "cases": [{k: v for k, v in CASE.items() if k != "margin"}]},
                  "margin is missing"),
    "unfinished study": ({**MARGIN, "completed": False}, "is unfinished"),
    "laws are a list": ({"kind": "comparison", "laws": []}, "laws"),
    "sweep without points": ({"kind": "sweep", "axes": [], "points": []}, "points"),
    "too many values": ({"kind": "sweep", "axes": [], "points": [POINT]}, "for each of axes"),
    "margin of another quantity": ({**MARGIN, "quantity": "jitter"}, "of jitter: must be of"),
    "run for a margin": (RUN, "is a result of runs: must be of margin of delay"),
}  # fmt: skip


@pytest.mark.parametrize(("content", "message"), MALFORMED.values(), ids=MALFORMED)
def test_unusable_baseline_is_refused_with_its_reason(content, message, tmp_path, funnel_hil):
    file = tmp_path / "baseline.json"
    content = json.dumps(content) if isinstance(content, dict) else content
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    output = funnel_hil.output("margin", "--baseline", file, "--out", tmp_path / "out", code=2)
    assert output.startswith("error: --baseline")
    assert message in output
    assert len(output) < 700
    assert not (tmp_path / "out").exists()


def test_nan_passes_no_gate():
    nan = delay(float("nan"))
    assert Gate(at_least=0.0).failures([nan])
    assert Gate(baseline={"arm, law": delay(1.0)}, tolerance=1e9).failures([nan])
    assert Gate(baseline={"arm, law": nan}).failures([delay(1.0)])


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (b'{"commit": "a", "time": "", "values": {"x": NaN}}', "line 1: must be an entry"),
        (b'{"commit": "a", "time": "", "values": {"x": "1"}}', "line 1: must be an entry"),
        (b'{"commit": 1}\n', "history.jsonl, line 1: must be an entry"),
        (b"\xff", "no text in UTF-8"),
        (b"[" * 100_000, "line 1: must be an entry"),
    ],
)
def test_unusable_history_is_refused_before_anything_runs(line, message, tmp_path, funnel_hil):
    (tmp_path / "history.jsonl").write_bytes(line)
    output = funnel_hil.output("simulate", "--history", tmp_path, "--out", tmp_path / "out", code=2)
    assert message in output
    output = funnel_hil.output("simulate", "--history", tmp_path / "history.jsonl", code=2)
    assert "must be a folder" in output


def test_commands_at_once_each_leave_an_entry(tmp_path):
    def append(number):
        with locked_history(tmp_path / "history") as entries:
            entries.append(Entry(str(number), "", {"arm, law": 1.0}))
            write_history(tmp_path / "history", "margin", entries, "ms")

    processes = [get_context("fork").Process(target=append, args=(each,)) for each in range(4)]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    assert [process.exitcode for process in processes] == [0] * 4
    commits = [entry.commit for entry in read_history(tmp_path / "history")]
    assert sorted(commits) == ["0", "1", "2", "3"]


HOSTILE = "a|b\n\x1b]0;title\x07\x1b[31mred\x00\x0b\ud800\uffff: [bold]c"


def test_files_for_ci_can_be_read_with_any_name(tmp_path):
    failures = {HOSTILE: f"{HOSTILE}: fell"}
    write_junit(tmp_path / "j.xml", [delay(1.0, HOSTILE)], failures)
    case = ET.parse(tmp_path / "j.xml").getroot().find("testcase")
    assert case.get("name") == "a|b\nred\ufffd\ufffd\\ud800\ufffd: [bold]c"
    write_markdown(tmp_path / "m.md", [delay(1.0, HOSTILE)], failures)
    *_, row = (tmp_path / "m.md").read_text().splitlines()
    assert row == "| a\\|b red\ufffd\ufffd\\ud800\ufffd: [bold]c | 1 ms | fell |"

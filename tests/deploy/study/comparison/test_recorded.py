"""Recorded runs side by side: in the terminal, in files and from Python."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
import pytest

import funnel_hil as interface
from deploy.judge.recorded_ticks import known_ticks
from deploy.reports.results import write_run
from deploy.run.execute import JudgedRun
from deploy.run.recording import record_failures
from deploy.run.run_folder import RunFolder, read_summary
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from deploy.studies.diff.sentences import verdict_on_runs
from deploy.studies.diff.tables import (
    difference_table,
    recorded_joint_tables,
    recorded_table,
    recorded_timing_table,
)
from deploy.study.comparison.recorded import recorded_runs
from tests.damage import damage_at
from tests.deploy.own_laws import own_law
from tests.deploy.reports.page_order import assert_shows_before_it_tells

SHORT = ("duration_s=0.3", "metrics.from_s=0")


def record(folder: Path, *changes: str, name: str = "paper_arm", faults: tuple[str, ...] = ()):
    """A recorded run in `folder`."""
    simulation = simulate(load_setup(name, [*SHORT, *changes]))
    with RunFolder.begin(simulation.setup, folder) as place:
        simulation.write_log(place.log)
        record_failures(place.log, faults)
        run = JudgedRun("", replace(simulation.data(), failures=faults))
        write_run(place, run, draws_report=False)
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("runs")
    record(path / "first")
    record(path / "again")
    record(
        path / "pushed",
        "faults=[{kind: torque_offset, joint: elbow, torque_nm: 5, at_s: 0.1, for_s: 0.1}]",
    )
    record(path / "other_law", "controller.law=smc", "duration_s=0.2")
    record(path / "iiwa", name="iiwa")
    record(path / "long", "duration_s=0.7")
    return path


def rows_of(table):
    return {cells[0].text: [cell.text for cell in cells[1:]] for cells in table.cells}


def test_runs_of_different_rates_are_compared_at_the_instants_that_both_have(folder, tmp_path):
    """Tick 100 of the one is 0.1 s, of the other 0.2 s: compared by tick they are 45 mrad apart."""
    slower = record(tmp_path / "slower", "rate_hz=500")
    (_, parting) = recorded_runs([folder / "first", slower]).partings
    assert parting.tick <= 10
    assert parting.largest_rad < 0.01


def test_gains_of_laws_that_no_run_has_are_no_difference(folder, tmp_path):
    idle, used = "controller.gains.pid.proportional=[9, 9, 9]", "controller.gains.ftsmc.eta=0.1"
    other = record(tmp_path / "other", idle, used, "controller.law=ftsmc")
    compared = recorded_runs([folder / "first", other])
    assert list(compared.differing) == ["controller.law", "controller.gains.ftsmc.eta"]


def test_diff_shows_gains_of_a_custom_law(tmp_path, import_folder):
    law, idle = f"controller.law={own_law(tmp_path, 'pass')}", "controller.gains.ftsmc.eta=0.1"
    early = record(tmp_path / "early", law, "controller.gains.custom={at_tick: 5}")
    late = record(tmp_path / "late", law, "controller.gains.custom={at_tick: 9}", idle)
    compared = recorded_runs([early, late])
    assert compared.differing == {"controller.gains.custom.at_tick": ["5", "9"]}


def test_a_run_that_is_repeated_is_the_same_to_the_bit(folder):
    compared = recorded_runs([folder / "first", folder / "again"])
    assert compared.labels == ["first", "again"]
    assert compared.partings == [None, None]
    assert compared.differing == {}
    rows = rows_of(recorded_table(compared))
    assert rows["Digest, compared with the first run"] == ["–", "same"]
    assert rows["First tick that differs"] == ["–", "never"]
    assert rows["… at (s)"] == ["–", "–"]
    assert rows["Largest difference of a position (mrad)"] == ["–", "0"]
    assert "the same at every tick" in verdict_on_runs(compared).headline


def test_clocks_are_those_that_the_runs_had(folder, tmp_path, funnel_hil):
    """A simulation is never in real time, whichever clock its scenario names."""
    changes = [word for change in (*SHORT, "clock=lockstep") for word in ("--set", change)]
    out = tmp_path / "lockstep"
    funnel_hil.output("run", "paper_arm", *changes, "--out", out, "--no-report")
    compared = recorded_runs([tmp_path / "lockstep", folder / "first"])
    assert compared.partings == [None, None]
    clocks = rows_of(recorded_table(compared))["Clock"]
    assert clocks == ["run in lockstep", "simulated in virtual time"]
    assert compared.differing == {}


@pytest.mark.parametrize("order", [("first", "gap"), ("gap", "first")])
def test_ticks_that_are_missing_are_no_parting(folder, tmp_path, funnel_hil, order):
    for name in order:
        shutil.copytree(folder / "long", tmp_path / name)
    damage_at(tmp_path / "gap" / "run.mcap", 250_000_000)
    compared = recorded_runs([tmp_path / name for name in order])
    assert compared.partings == [None, None]
    output = funnel_hil.output("diff", *compared.paths, "--out", tmp_path / "diff", "--no-report")
    output = " ".join(output.split())
    assert "leaves" not in output
    assert "they are the same at every tick that is known of both" in output
    known = known_ticks(compared.runs[order.index("gap")].data)
    inside = f"inside its bounds at the {known.known} of 700 ticks at which it is known"
    assert f"gap: {inside}" in output
    assert f"gap: The true motion is known at {known.known} of 700 ticks; those at" in output


def test_a_parting_behind_missing_ticks_is_at_its_tick(folder, tmp_path):
    push = "faults=[{kind: torque_offset, joint: elbow, torque_nm: 5, at_s: 0.5, for_s: 0.1}]"
    pushed = record(tmp_path / "pushed", push, "duration_s=0.7")
    shutil.copytree(folder / "long", tmp_path / "gap")
    damage_at(tmp_path / "gap" / "run.mcap", 250_000_000)
    (_, parting) = recorded_runs([tmp_path / "gap", pushed]).partings
    assert parting.tick in (500, 501)


def test_a_run_that_ends_before_another_is_the_same_until_then(folder, tmp_path):
    short = record(tmp_path / "short", "duration_s=0.2")
    compared = recorded_runs([folder / "first", short])
    assert compared.partings[1].tick == 201
    verdict = verdict_on_runs(compared)
    assert verdict.headline.endswith("they are the same until one ends")
    assert "short: bit-identical to first at every tick before 201, where one of the runs ends" in (
        verdict.reasons
    )


def test_runs_part_at_the_tick_at_which_something_else_happens(folder):
    compared = recorded_runs([folder / "first", folder / "pushed"])
    parting = compared.partings[1]
    # A torque from 0.1 s on is on the joint at tick 100, and in its measurement a tick later.
    assert parting.tick in (100, 101)
    runs = [interface.load_run(path) for path in compared.paths]
    first, pushed = (run.table("plant_truth")["position"] for run in runs)
    assert parting.largest_rad == np.abs(first - pushed).max() > 0.0
    assert list(compared.differing) == ["faults"]
    assert rows_of(recorded_table(compared))["Digest, compared with the first run"] == [
        "–",
        "differs",
    ]


def test_numbers_are_those_of_each_summary(folder):
    paths = [folder / "first", folder / "other_law"]
    compared = recorded_runs(paths)
    summaries = [read_summary(path) for path in paths]
    rms, usage, travel = recorded_joint_tables(compared)
    for joint, name in enumerate(summaries[0]["tracking"]["joint_names"]):
        values = [1e3 * summary["tracking"]["rms_rad"][joint] for summary in summaries]
        *reported, ratio = rms.rows[joint][1:]
        assert reported == pytest.approx(values)
        assert ratio.startswith("× ")
        assert travel.rows[joint][0] == name
    worst = np.array([row[1:3] for row in usage.rows]).max(axis=0) / 100.0
    margins = [summary["bounds"]["margin_min"] for summary in summaries]
    np.testing.assert_allclose(1.0 - worst, margins)
    assert {"clock", "seed"}.isdisjoint(compared.differing)
    assert compared.differing["duration_s"] == ["0.3", "0.2"]
    assert compared.differing["controller.law"] == ['"fixed_time_neural"', '"smc"']
    assert rows_of(difference_table(compared))["duration_s"] == ["0.3", "0.2"]
    steps = rows_of(recorded_timing_table(compared))
    assert "Control step, p99" in steps
    assert not any(name.startswith("Round trip") for name in steps)  # 0 in both


def test_the_command_shows_writes_and_reports_again(folder, tmp_path, funnel_hil):
    out = tmp_path / "diff"
    output = funnel_hil.output("diff", folder / "first", folder / "pushed", "--out", out)
    for part in ("First tick that differs", "Worst error in % of its bound", "faults"):
        assert part in output
    assert "Timing" not in output  # folded in the report
    summary = json.loads((out / "summary.json").read_text())
    assert summary["kind"] == "diff"
    assert summary["completed"]
    assert list(summary["runs"]) == ["first", "pushed"]
    page = (out / "report.html").read_text()
    assert_shows_before_it_tells(page)
    assert page.index("<details") < page.index("<h3>Timing (µs)</h3>") < page.index("<h3>Counts<")
    for panel in ("errors", "positions-apart", "torques", "control-step", "tip-paths"):
        assert f'id="{panel}"' in page
    assert 'id="round-trip"' not in page  # always 0: there is nothing to draw
    (out / "report.html").unlink()
    funnel_hil.output("report", out)
    assert (out / "report.html").read_text() == page
    output = funnel_hil.output("runs", "list", tmp_path)
    assert "first pushed" in output


def test_files_are_compared_as_they_were_recorded(tmp_path, funnel_hil):
    names = load_setup("paper_arm").robot.joint_names
    columns = ",".join(["time_s", *(f"{name}.position_rad" for name in names)])
    delays = tmp_path / "delays.txt"
    delays.write_text("0.1\n0.2\n")
    for run, angle, end in (("a", "0.1", "\r\n"), ("b", "0.1", "\n"), ("c", "0.2", "\n")):
        rows = [",".join([time, *[angle] * len(names)]) for time in ("0", "0.5", "1")]
        (tmp_path / "reference.csv").write_bytes(end.join([columns, *rows, ""]).encode())
        record(
            tmp_path / run,
            f"reference={{kind: csv, file: {tmp_path / 'reference.csv'}}}",
            f"link.uplink={{distribution: empirical, distribution_file: {delays}}}",
            "duration_s=0.1",
        )
    (tmp_path / "reference.csv").unlink()
    delays.unlink()
    funnel_hil.output("diff", *(tmp_path / run for run in "ab"), "--out", tmp_path / "diff")
    assert recorded_runs([tmp_path / "a", tmp_path / "b"]).differing == {}
    other = recorded_runs([tmp_path / "a", tmp_path / "c"])
    assert other.differing == {"reference.file": ["file 1", "file 2"]}


def test_labels_are_as_long_as_they_must_be(folder, tmp_path):
    other = record(tmp_path / "elsewhere" / "first")
    compared = recorded_runs([folder / "first", other / "run.mcap"])
    assert compared.labels == [f"{folder.name}/first", "elsewhere/first"]


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["first"], "needs two recorded runs or more"),
        (["first", "first"], "is given twice"),
        (["first", "iiwa"], "must be the joints of"),
        (["first", "nowhere"], "has no run.mcap"),
    ],
)
def test_what_cannot_be_compared_is_refused(names, message, folder, tmp_path, funnel_hil):
    out = tmp_path / "diff"
    output = funnel_hil.output("diff", *(folder / name for name in names), "--out", out, code=2)
    assert message in output
    assert not out.exists()


def test_a_comparison_is_no_run(folder, tmp_path, funnel_hil):
    changes = [word for change in SHORT for word in ("--set", change)]
    funnel_hil("compare", "--laws", "smc,pid", *changes, "--out", tmp_path / "laws")
    output = funnel_hil.output("diff", folder / "first", tmp_path / "laws", code=2)
    assert "is not a run but has results of kind comparison, with runs in" in output
    assert "to compare studies, repeat one with --baseline" in output
    compared = recorded_runs([tmp_path / "laws" / "smc", tmp_path / "laws" / "pid"])
    assert compared.labels == ["smc", "pid"]


def test_from_python_it_is_arrays_rows_and_figures(folder, tmp_path):
    compared = interface.diff(folder / "first", folder / "pushed", out=tmp_path / "diff")
    assert (tmp_path / "diff" / "report.html").is_file()
    assert compared.first_different_ticks["pushed"] in (100, 101)
    assert list(compared.differing) == ["faults"]
    assert compared["pushed"].errors_rad.shape == (301, 3)
    assert [row["run"] for row in compared.rows] == ["first", "pushed"]
    assert list(compared.frame()["run"]) == ["first", "pushed"]
    figure = compared.figure("errors")
    assert isinstance(figure, go.Figure)
    assert {"first", "pushed"} <= {trace.name for trace in figure.data}
    with pytest.raises(interface.InputError, match="must be one of"):
        compared["missing"]


def test_unrecorded_faults_are_kept_when_a_run_is_judged_again(folder, tmp_path, funnel_hil):
    path = record(tmp_path / "killed", faults=("the controller was killed by SIGKILL",))
    before = read_summary(path)
    funnel_hil.output("report", path)
    assert read_summary(path)["faults"] == before["faults"]
    assert not read_summary(path)["completed"]
    assert interface.load_run(path).faults == before["faults"]
    compared = recorded_runs([folder / "first", path])
    assert rows_of(recorded_table(compared))["Bounds"] == ["kept", "faulted"]


def test_a_comparison_reported_later_keeps_how_the_process_ended(tmp_path, funnel_hil):
    out = tmp_path / "laws"
    words = ["--set", "controller.process=[sh, -c, 'echo no such robot >&2; exit 3']"]
    words += [word for change in SHORT for word in ("--set", change)]
    funnel_hil.output("compare", "--laws", "process", *words, "--out", out, code=1)
    (faults,) = (run["faults"] for run in read_summary(out)["laws"].values())
    assert "no such robot" in faults[0]
    funnel_hil("report", out)
    assert [run["faults"] for run in read_summary(out)["laws"].values()] == [faults]
    assert "no such robot" in (out / "report.html").read_text()

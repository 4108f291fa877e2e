"""What is there: scenarios, runs as tables, folders of results."""

from __future__ import annotations

import json
import shutil
from importlib.metadata import version

import numpy as np
import pytest
from pyarrow import csv, parquet

from bus_schema.recording.atomic_files import write_json
from deploy.run.run_folder import load_run
from deploy.scenario.scenario import SHIPPED
from deploy.study.definition import SHIPPED as STUDIES


@pytest.fixture(scope="module")
def recorded(tmp_path_factory, funnel_hil):
    folder = tmp_path_factory.mktemp("results") / "a"
    assert funnel_hil("simulate", "--set", "duration_s=0.1", "--out", folder)[0] == 0
    return folder


@pytest.fixture
def shelf(recorded, tmp_path):
    """Three results: a run of today, an old one, and one that came to no end."""
    manifest = json.loads((recorded / "manifest.json").read_text())
    summary = json.loads((recorded / "summary.json").read_text())
    for name, changes, more in (
        ("new", {}, {}),
        ("old", {"started": "2020-01-01T00:00:00+0000"}, {}),
        ("broken", {}, {"completed": False, "verdict": "interrupted"}),
    ):
        (tmp_path / name).mkdir()
        write_json(tmp_path / name / "manifest.json", manifest | changes)
        write_json(tmp_path / name / "summary.json", summary | more)
    (tmp_path / "foreign").mkdir()
    return tmp_path


def names_in(folder):
    return sorted(path.name for path in folder.iterdir())


def test_version(funnel_hil):
    assert funnel_hil("--version") == (0, f"funnel-hil {version('funnel-hil')}\n")


def test_scenarios_are_listed_with_what_they_are(funnel_hil):
    output = funnel_hil.output("scenarios")
    faults = [f"faults/{file.stem}" for file in SHIPPED.glob("faults/*.yaml")]
    assert "faults/encoder_stuck" in faults
    for name in [file.stem for file in (*SHIPPED.glob("*.yaml"), *STUDIES.glob("*.yaml"))] + faults:
        (line,) = [line for line in output.splitlines() if line.split()[:1] == [name]]
        assert len(line.split()) > 3


def test_export_writes_every_series_in_both_formats(funnel_hil, recorded):
    output = funnel_hil.output("export", recorded, "--csv", "--parquet")
    assert len(output.split()) == 12
    data, _ = load_run(recorded)
    folder = recorded / "export"
    for table in (
        csv.read_csv(folder / "tracking.csv"),
        parquet.read_table(folder / "tracking.parquet"),
    ):
        errors = [table[f"error.{name}"].to_numpy() for name in data.setup.robot.joint_names]
        np.testing.assert_array_equal(np.stack(errors, axis=-1), data.true_errors_rad)
    efforts = parquet.read_table(folder / "joint_commands.parquet")["effort.elbow"].to_numpy()
    np.testing.assert_array_equal(efforts, data.tables["joint_commands"]["effort"][:, 2])


def test_export_of_a_series_that_is_none_names_one_that_is(funnel_hil, recorded, tmp_path):
    words = ("--csv", "--series", "trcking", "--out", tmp_path / "out")
    output = funnel_hil.output("export", recorded, *words, code=2)
    assert "did you mean tracking?" in output
    assert not (tmp_path / "out").exists()


def test_list_and_tags(funnel_hil, shelf):
    assert funnel_hil("runs", "tag", shelf / "old", "paper", "v1")[1] == "paper, v1\n"
    assert funnel_hil("runs", "tag", shelf / "old", "--remove", "v1")[1] == "paper\n"
    output = funnel_hil.output("runs", "list", shelf)
    rows = output.splitlines()[1:]
    assert [row.split()[0].rpartition("/")[2] for row in rows] == ["old", "broken", "new"]
    assert "2020-01-01" in rows[0]
    assert "bounds kept" in rows[0]
    assert "paper" in rows[0]
    assert any("interrupted" in row and "broken" in row for row in rows)
    only = funnel_hil("runs", "list", shelf, "--tag", "paper")[1].splitlines()[1:]
    assert len(only) == 1


def test_prune_shows_first_and_keeps_what_is_tagged_or_not_ours(funnel_hil, shelf):
    (shelf / "broken" / "notes.txt").write_text("mine")
    output = funnel_hil.output("runs", "prune", shelf, "--older-than", "30")
    assert "1 would be removed; --yes removes them" in output
    assert names_in(shelf) == ["broken", "foreign", "new", "old"]
    funnel_hil("runs", "tag", shelf / "old", "paper")
    assert "0 removed" in funnel_hil("runs", "prune", shelf, "--older-than", "30", "--yes")[1]
    funnel_hil("runs", "tag", shelf / "old", "--remove", "paper")
    assert "1 removed" in funnel_hil("runs", "prune", shelf, "--older-than", "30", "--yes")[1]
    assert "1 removed" in funnel_hil("runs", "prune", shelf, "--incomplete", "--yes")[1]
    assert names_in(shelf) == ["broken", "foreign", "new"]
    assert names_in(shelf / "broken") == ["notes.txt"]


def test_list_distinguishes_faulted_and_unfinished_runs(funnel_hil, shelf):
    summary = json.loads((shelf / "new" / "summary.json").read_text())
    faulted, half = {"verdict": "faulted"}, {"verdict": "interrupted"}
    for name, changes in (
        ("whole", faulted),
        ("of_laws", {"kind": "comparison", "laws": {"a": summary, "b": {**summary, **faulted}}}),
        ("half", {"kind": "comparison", "laws": {"a": {**summary, **half}}}),
    ):  # fmt: skip
        shutil.copytree(shelf / "new", shelf / name)
        write_json(shelf / name / "summary.json", summary | changes)
    shutil.copytree(shelf / "new", shelf / "older")
    without = {name: value for name, value in summary.items() if name != "verdict"}
    write_json(shelf / "older" / "summary.json", without)
    rows = funnel_hil("runs", "list", shelf)[1].splitlines()[1:]
    output = {row.split()[0].rpartition("/")[2]: row for row in rows}
    ended = {"whole", "of_laws"}
    assert {name for name, row in output.items() if "faulted" in row} == ended
    gone = {"broken", "half"}
    assert {name for name, row in output.items() if "interrupted" in row} == gone
    assert "older version" in output["older"]  # its end is unknown, so it stays
    assert "2 removed" in funnel_hil("runs", "prune", shelf, "--incomplete", "--yes")[1]
    assert set(names_in(shelf)) == {*output, "foreign"} - gone


def test_through_a_pipe_a_row_is_a_line(funnel_hil, shelf):
    name = "a_name_that_is_longer_than_lines_are_" * 6
    (shelf / "new").rename(shelf / name)
    output = funnel_hil("runs", "list", shelf)[1].splitlines()
    assert len(output) == 4
    (row,) = [line for line in output if line.startswith(f"{shelf / name} ")]
    assert "bounds kept" in row
    pruned = funnel_hil("runs", "prune", shelf, "--older-than", "0")[1].splitlines()
    assert len(pruned) == 5
    assert any(line.startswith(f"{shelf / name} ") for line in pruned)


def test_prune_removes_all_that_a_run_and_its_export_left(funnel_hil, recorded, tmp_path):
    run = tmp_path / "compared" / "pid"
    shutil.copytree(recorded, run)
    for name in ("summary.json", "manifest.json"):
        shutil.copy(recorded / name, run.parent)
    assert funnel_hil("export", run, "--csv")[0] == 0
    assert funnel_hil("runs", "prune", tmp_path, "--older-than", "0", "--yes")[0] == 0
    assert names_in(tmp_path) == []

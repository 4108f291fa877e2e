"""Studies that grow: what is there is not run again, and the table is that of one made at once."""

from __future__ import annotations

import json

import pytest
from pyarrow import parquet

import funnel_hil as interface
from deploy.reports.studies.conclude import conclude_study
from deploy.runs.conditions import host_of, provenance_of
from deploy.runs.run_folder import grown_from
from deploy.runs.run_rows import read_rows
from deploy.scenario.yaml_files import ScenarioError, read_yaml
from deploy.study.conduct import carry_out
from deploy.study.folder import StudyFolder, create_folder, find_folder
from deploy.study.robustness import margin_study
from tests.deploy.study.studies import (
    NOISE,
    TIED,
    Here,
    Silent,
    limits,
    made_up,
    make_sweep,
    margin_of,
)

KEY = "controller.model_scale"


def conclude(study, path, workers):
    """Carry a study out, on, or make it grow, as the commands do; its rows and summary."""
    folder = StudyFolder(find_folder(study, path) or create_folder(study, path), study)
    folder.lock()
    with folder:
        folder.become()
        carry_out(study, workers, folder, Silent(), workers.stop)
        folder.flush()
        summary = conclude_study(study, folder)
    summary.pop("conditions")
    return read_rows(folder.rows_file), summary


def assert_grown_as_at_once(small, large, tmp_path, do):
    """The runs that growing took, after checking what it gives."""
    first, more, at_once = Here(do), Here(do, seed=1), Here(do, seed=2)
    conclude(small(), tmp_path / "grown", first)
    grown = conclude(large(), tmp_path / "grown", more)
    assert grown == conclude(large(), tmp_path / "at_once", at_once)
    for kept in ("scenarios", "."):
        names = [{f.name for f in (tmp_path / w / kept).iterdir()} for w in ("grown", "at_once")]
        assert names[0] == names[1]
    done = [{(str(run.columns), run.seed) for run in each.submitted} for each in (first, more)]
    assert not done[0] & done[1]
    assert done[0]
    return more.submitted, at_once.submitted


@pytest.mark.parametrize(
    ("small", "large"),
    [
        ({"seeds": 1}, {"seeds": 3}),
        ({"seeds": [3]}, {"seeds": [1, 2, 3]}),
        ({"grid": {TIED: [1], KEY: [1.0]}}, {}),
        ({"grid": {TIED: [1], KEY: [1.2]}, "seeds": [2]}, {"grid": {TIED: [0, 1], KEY: [1.2, 1]}}),
    ],
)
def test_a_sweep_grows_by_points_and_seeds(small, large, tmp_path):
    whole = {"grid": {TIED: [0, 1, 2], KEY: [0.8, 1.0, 1.2]}, "seeds": 2, "set": NOISE}

    def do(run):
        return made_up(run, violation_fraction=0.1 * run.seed, margin_min=len(str(run.columns)))

    more, at_once = assert_grown_as_at_once(
        lambda: make_sweep(tmp_path, **{**whole, **small}),
        lambda: make_sweep(tmp_path, **{**whole, **large}),
        tmp_path,
        do,
    )
    assert 0 < len(more) < len(at_once)


@pytest.mark.parametrize(
    ("small", "large"),
    [
        ({"laws": ["smc"]}, {"laws": ["pid", "smc"]}),
        ({"seeds": 1}, {"seeds": [2, 1]}),
        # The second start loses where the first held: probes of before are wanted no more.
        ({"offsets": [1.0]}, {"offsets": [-0.5, 1.0]}),
    ],
)
def test_a_search_for_margins_grows_by_laws_seeds_and_starts(small, large, tmp_path):
    more, at_once = assert_grown_as_at_once(
        lambda: margin_of(**small), lambda: margin_of(**large), tmp_path, limits
    )
    assert 0 < len(more) < len(at_once)


def test_a_share_of_plants_grows_by_plants_values_and_laws(tmp_path):
    def study(**values):
        given = {
            "scenarios": ["paper_arm"], "laws": ["smc"], "seeds": [1], "values": [4],
            "plants": 2, "set": NOISE, **values,
            "uncertainty": {
                "plant.payload_kg": {"distribution": "uniform", "from": 0, "to": 1},
                "plant.encoder.resolution_rad": {"distribution": "choice", "values": [0.0, 1e-6]},
            },
        }  # fmt: skip
        return margin_study(given, tmp_path / "m.yaml")

    def do(run):
        return made_up(run, violation_fraction=run.columns["plant.payload_kg"] / 10)

    more, at_once = assert_grown_as_at_once(
        study, lambda: study(laws=["pid", "smc"], values=[2, 4], plants=3), tmp_path, do
    )
    assert len(at_once) - len(more) == 2


def test_growing_that_is_interrupted_goes_on(tmp_path):
    grid = {TIED: list(range(6))}
    small = make_sweep(tmp_path, {TIED: [1, 4]}, seeds=[2])
    conclude(small, tmp_path / "s", Here(made_up))
    for at_most in (1, 2):
        rows, summary = conclude(
            make_sweep(tmp_path, grid, seeds=2), tmp_path / "s", Here(made_up, at_most=at_most)
        )
        assert not summary["completed"]
    assert len(rows) == 2 + 1 + 2
    last = Here(made_up)
    rows, summary = conclude(make_sweep(tmp_path, grid, seeds=2), tmp_path / "s", last)
    assert summary["completed"]
    assert len(last.submitted) == 12 - 5
    assert [(row["point"], row["seed"]) for row in rows] == [
        (f"{point:05d}", seed) for point in range(6) for seed in (1, 2)
    ]


def test_a_kill_right_after_the_folder_has_become_another_loses_nothing(tmp_path):
    conclude(make_sweep(tmp_path, {TIED: [2]}), tmp_path / "s", Here(made_up))
    grown = make_sweep(tmp_path, {TIED: [1, 2]})
    StudyFolder(find_folder(grown, tmp_path / "s"), grown).become()
    team = Here(made_up)
    rows, _ = conclude(make_sweep(tmp_path, {TIED: [1, 2]}), tmp_path / "s", team)
    assert [run.columns["link.uplink.delay_ms"] for run in team.submitted] == [1.0]
    assert [row["link.uplink.delay_ms"] for row in rows] == [1.0, 2.0]


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"seeds": 1}, "seeds = [1]: must have all of [1, 2]"),
        ({"grid": {TIED: [0]}}, f"grid.{TIED} = [0]: must have all of [0, 1]"),
        ({"grid": {TIED: [0, 1], KEY: [1]}}, f"grid.{KEY} = [1]: must be left out"),
        ({"set": {"duration_s": 5}}, "set = {'duration_s': 5}: must be {}"),
        ({"scenario": "iiwa"}, "scenario = 'iiwa': must be 'paper_arm'"),
        ({"name": "other"}, "name = 'other': must be 's'"),
    ],
)
def test_whatever_else_differs_is_named(values, said, tmp_path):
    given = {"grid": {TIED: [0, 1]}, "seeds": 2}
    path = create_folder(make_sweep(tmp_path, **given), tmp_path / "s")
    before = read_yaml(path / "study.yaml")
    with pytest.raises(ScenarioError) as refused:
        find_folder(make_sweep(tmp_path, **{**given, **values}), path)
    assert said in str(refused.value)
    assert str(path / "study.yaml") in str(refused.value)
    assert read_yaml(path / "study.yaml") == before


def test_another_kind_of_study_or_a_changed_scenario_is_refused(tmp_path):
    path = create_folder(make_sweep(tmp_path, {TIED: [0]}), tmp_path / "s")
    with pytest.raises(ScenarioError, match="kind = 'margin': must be 'sweep'"):
        find_folder(margin_of(), path)
    own = tmp_path / "own.yaml"
    own.write_text("extends: paper_arm\nname: own\n")
    path = create_folder(make_sweep(tmp_path, {TIED: [0]}, scenario=str(own)), tmp_path / "o")
    own.write_text("extends: paper_arm\nname: own\nduration_s: 3\n")
    with pytest.raises(ScenarioError, match="scenario own: has changed"):
        find_folder(make_sweep(tmp_path, {TIED: [0, 1]}, scenario=str(own)), path)


def test_real_runs_from_the_command_and_from_python(tmp_path, funnel_hil):
    changes = {"duration_s": 0.1, "metrics.from_s": 0, **NOISE}
    grid = {"link.uplink.delay_ms": [1]}
    told = []
    interface.sweep("paper_arm", grid, changes, seeds=1, out=tmp_path / "grown")
    grid["link.uplink.delay_ms"].append(0)
    grown = interface.sweep(
        "paper_arm", grid, changes, seeds=2, out=tmp_path / "grown",
        progress=lambda *counts: told.append(counts),
    )  # fmt: skip
    at_once = interface.sweep("paper_arm", grid, changes, seeds=2)
    assert grown.rows == at_once.rows
    assert told[-1] == (4, 4)
    table = parquet.read_table(tmp_path / "grown" / "sweep.parquet")
    assert table.column("digest").to_pylist() == [row["digest"] for row in at_once.rows]
    code, said = funnel_hil(
        "simulate", tmp_path / "grown" / "scenarios" / "00001.yaml", "--out", tmp_path / "one"
    )
    assert code == 0, said
    one = interface.load_run(tmp_path / "one")
    assert one.summary["digest"] == table.to_pylist()[2]["digest"]


def test_what_has_grown_names_every_version_and_host_that_made_it():
    def made(version, kernel, started):
        host = {"machine": "x86_64", "kernel": kernel, "cpus": 2}
        return {"versions": {"funnel-hil": version}, "host": host, "started": started}

    first, second, third = (
        made("0.0.9", "5", "Monday"),
        made("1", "6", "Tuesday"),
        made("1", "6", "W"),
    )
    manifest = grown_from(grown_from(first, second), third)
    told = {**provenance_of(manifest), **host_of(manifest)}
    assert told["version"] == "funnel-hil 0.0.9, then funnel-hil 1"
    assert told["date"] == "Monday, then Tuesday, then W"
    assert told["host"] == (
        "x86_64, kernel 5, 2 of 2 CPUs usable, then x86_64, kernel 6, 2 of 2 CPUs usable"
    )


def test_conditions_of_a_grown_study_are_not_the_last_calls_alone(tmp_path):
    path = tmp_path / "grown"
    conclude(make_sweep(tmp_path, {KEY: [1.0]}, seeds=1), path, Here(made_up))
    manifest = json.loads((path / "manifest.json").read_text())
    manifest["versions"]["funnel-hil"] = "0.0.9"
    (path / "manifest.json").write_text(json.dumps(manifest))
    conclude(make_sweep(tmp_path, {KEY: [1.0]}, seeds=2), path, Here(made_up))
    summary = json.loads((path / "summary.json").read_text())
    assert summary["conditions"]["version"].startswith("funnel-hil 0.0.9, then funnel-hil ")

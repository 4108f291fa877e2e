"""Studies that grow: what is there is not run again, and the table is that of one made at once."""

from __future__ import annotations

import json
import re

import pytest
from pyarrow import parquet

import funnel_hil as interface
from deploy.judge.run_rows import read_rows
from deploy.reports.studies.results import write_study
from deploy.scenario.referenced_files import find_urdf
from deploy.scenario.yaml_files import ScenarioError, read_yaml
from deploy.studies.margin.margin_study import margin_study
from deploy.study.execution.folder import StudyFolder, create_folder, find_folder, opened
from deploy.study.execution.runner import carry_out
from tests.deploy.study.studies import NOISE, TIED, Here, limits, made_up, make_sweep, margin_of

KEY = "controller.model_scale"


def conclude(study, path, workers):
    """Carry a study out, on, or make it grow, as the commands do; its rows and summary."""
    with opened(study, find_folder(study, path), path) as folder:
        carry_out(study, workers, folder, workers.stop)
        summary = write_study(study, folder).summary
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


TRIED = {
    "laws": ["smc", "pid", "tsmc"],
    "compensation": [False, True],
    "drive_feedback": [True, False],
    "running": [False, True],
    "scenarios": ["paper_arm", "tiny_delay"],
    "seeds": [3, 2, 1],
    "offsets": [1.0, -0.5, 0.5],
    "values": [2.0, 4.0, 8.0],
}
"""What studies of cases try one after another."""


@pytest.mark.parametrize(
    ("plants", "key", "is_prepended"),
    [
        *((None, key, at_front) for key in TRIED if key != "values" for at_front in (False, True)),
        *((2, key, True) for key in ("values", "seeds", "laws")),  # what plants order otherwise
    ],
)
def test_a_study_of_cases_grows_in_every_direction(key, is_prepended, plants, tmp_path):
    (tmp_path / "tiny_delay.yaml").write_text(
        "{extends: paper_arm, name: tiny_delay, seed: 5, plant: {payload_kg: 0.5}}"
    )
    scenarios = {"paper_arm": "paper_arm", "tiny_delay": str(tmp_path / "tiny_delay.yaml")}

    def study(values):
        values = [scenarios.get(each, each) for each in values]
        drawn = {"plant.encoder.resolution_rad": {"distribution": "choice", "values": [0.0, 1e-6]}}
        of_plants = {"plants": plants, "values": [4.0], "uncertainty": drawn}
        of_search = {"limit": 8, "offsets": [1.0]}
        given = {"scenarios": ["paper_arm"], "laws": ["smc"], "seeds": [1], "set": NOISE}
        given |= of_plants if plants else of_search
        return margin_study({**given, key: values}, tmp_path / "m.yaml")

    whole = TRIED[key]
    part = whole[1:] if is_prepended else whole[:1]
    more, at_once = assert_grown_as_at_once(
        lambda: study(part), lambda: study(whole), tmp_path, made_up
    )
    assert 0 < len(more) < len(at_once)


def test_a_share_of_plants_grows_by_plants(tmp_path):
    ranges = {"plant.payload_kg": {"distribution": "uniform", "from": 0, "to": 1}}
    given = {"laws": ["smc"], "values": [4], "set": NOISE, "uncertainty": ranges}
    more, at_once = assert_grown_as_at_once(
        *(lambda n=n: margin_study({**given, "plants": n}, tmp_path / "m.yaml") for n in (2, 3)),
        tmp_path,
        lambda run: made_up(run, violation_fraction=run.columns["plant.payload_kg"] / 10),
    )
    assert len(at_once) - len(more) == 2


def test_a_search_grows_where_a_new_start_takes_it_another_way(tmp_path):
    # The second start loses where the first held: probes of before are wanted no more.
    more, at_once = assert_grown_as_at_once(
        lambda: margin_of(offsets=[1.0]), lambda: margin_of(offsets=[-0.5, 1.0]), tmp_path, limits
    )
    assert 0 < len(more) < len(at_once)


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
    ("values", "message"),
    [
        ({"seeds": 1}, "seeds = [1]: must have all of [1, 2]"),
        ({"grid": {TIED: [0]}}, f"grid.{TIED} = [0]: must have all of [0, 1]"),
        ({"grid": {TIED: [0, 1], KEY: [1]}}, f"grid.{KEY} = [1]: must be left out"),
        ({"set": {"duration_s": 5}}, "set = {'duration_s': 5}: must be {}"),
        ({"scenario": "iiwa"}, "scenario = 'iiwa': must be 'paper_arm'"),
        ({"name": "other"}, "name = 'other': must be 's'"),
    ],
)
def test_any_other_difference_is_named(values, message, tmp_path):
    given = {"grid": {TIED: [0, 1]}, "seeds": 2}
    path = create_folder(make_sweep(tmp_path, **given), tmp_path / "s")
    before = read_yaml(path / "study.yaml")
    with pytest.raises(ScenarioError) as refused:
        find_folder(make_sweep(tmp_path, **{**given, **values}), path)
    assert message in str(refused.value)
    assert str(path / "study.yaml") in str(refused.value)
    assert read_yaml(path / "study.yaml") == before


def test_another_kind_of_study_or_a_changed_scenario_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = create_folder(make_sweep(tmp_path, {TIED: [0]}), tmp_path / "s")
    with pytest.raises(ScenarioError, match="kind = 'margin': must be 'sweep'"):
        find_folder(margin_of(), path)
    own = tmp_path / "own.yaml"
    own.write_text("extends: paper_arm\nname: own\n")
    path = create_folder(make_sweep(tmp_path, {TIED: [0]}, scenario=str(own)), tmp_path / "o")
    create_folder(make_sweep(tmp_path, {TIED: [0]}, scenario=str(own)), None)
    for changed in ("name: own\nduration_s: 3", "name: other"):
        own.write_text(f"extends: paper_arm\n{changed}\n")
        with pytest.raises(ScenarioError, match="scenario own: has changed"):
            find_folder(make_sweep(tmp_path, {TIED: [0, 1]}, scenario=str(own)), path)
    own.write_text("extends: paper_arm\nname: own\nduration_s: 3\n")
    with pytest.raises(ScenarioError, match="scenario own: has changed"):
        find_folder(make_sweep(tmp_path, {TIED: [0]}, scenario=str(own)), None)  # by its name


def test_two_scenarios_with_one_name_are_refused(tmp_path):
    for name in "ab":
        (tmp_path / f"{name}.yaml").write_text("extends: paper_arm\nname: same\n")
    with pytest.raises(ScenarioError, match=r"a\.yaml and .*b\.yaml are both called 'same'"):
        margin_of(scenarios=[str(tmp_path / f"{name}.yaml") for name in "ab"])


def test_real_runs_from_the_command_and_from_python(tmp_path, funnel_hil):
    changes = {"duration_s": 0.1, "metrics.from_s": 0, **NOISE}
    grid = {"link.uplink.delay_ms": [1]}
    reported = []
    interface.sweep("paper_arm", grid, changes, seeds=1, out=tmp_path / "grown")
    grid["link.uplink.delay_ms"].append(0)
    grown = interface.sweep(
        "paper_arm", grid, changes, seeds=2, out=tmp_path / "grown",
        progress=lambda *counts: reported.append(counts),
    )  # fmt: skip
    at_once = interface.sweep("paper_arm", grid, changes, seeds=2)
    assert grown.rows == at_once.rows
    assert reported[-1] == (4, 4)
    table = parquet.read_table(tmp_path / "grown" / "sweep.parquet")
    assert table.column("digest").to_pylist() == [row["digest"] for row in at_once.rows]
    funnel_hil.output(
        "simulate", tmp_path / "grown" / "scenarios" / "00001.yaml", "--out", tmp_path / "one"
    )
    one = interface.load_run(tmp_path / "one")
    assert one.summary["digest"] == table.to_pylist()[2]["digest"]


def test_conditions_of_a_grown_study_are_not_the_last_calls_alone(tmp_path):
    path = tmp_path / "grown"
    conclude(make_sweep(tmp_path, {KEY: [1.0]}, seeds=1), path, Here(made_up))
    manifest = json.loads((path / "manifest.json").read_text())
    versions, host = manifest["versions"], manifest["host"]
    own = (versions["funnel-hil"], host["kernel"])
    versions["funnel-hil"], host["kernel"], manifest["started"] = "0.0.9", "5", "Monday"
    (path / "manifest.json").write_text(json.dumps(manifest))
    for seeds in (2, 3):  # what is the same again is named once
        conclude(make_sweep(tmp_path, {KEY: [1.0]}, seeds=seeds), path, Here(made_up))
    conditions = json.loads((path / "summary.json").read_text())["conditions"]
    assert conditions["version"] == f"funnel-hil 0.0.9, then funnel-hil {own[0]}"
    assert re.findall("kernel ([^,]*), ", conditions["host"]) == ["5", own[1]]
    assert conditions["date"].startswith("Monday, then 20")


def test_a_changed_file_that_a_grid_names_is_noticed(tmp_path):
    own = find_urdf("paper_arm", tmp_path).read_text(encoding="utf-8")
    for name in "ab":
        (tmp_path / f"{name}.urdf").write_text(own, encoding="utf-8")
    files = [str(tmp_path / f"{name}.urdf") for name in "ab"]

    def study(*names):
        return make_sweep(tmp_path, {"robot.urdf": list(names)})

    path = create_folder(study(files[0]), tmp_path / "s")
    assert find_folder(study(*files), path) == path
    (tmp_path / "b.urdf").write_text(own.replace("0.0", "0.00", 1), encoding="utf-8")
    assert find_folder(study(*files), path) == path  # which it did not have yet
    path = create_folder(study(*files), tmp_path / "both")
    assert find_folder(study(*files), path) == path
    (tmp_path / "b.urdf").write_text(own.replace("0.0", "0.000", 1), encoding="utf-8")
    with pytest.raises(ScenarioError, match=r"file .*b\.urdf: has changed"):
        find_folder(study(*files), path)


def test_an_axis_does_not_grow_by_values_of_another_type(tmp_path):
    axis = "robot.initial_offset_rad"
    path = create_folder(make_sweep(tmp_path, {axis: [0, 0.1]}), tmp_path / "s")
    assert find_folder(make_sweep(tmp_path, {axis: [0, 0.1, 0.2]}), path) == path
    with pytest.raises(ScenarioError, match=rf"grid\.{axis} = .*: must all be numbers"):
        find_folder(make_sweep(tmp_path, {axis: [0, 0.1, [0.1, 0.1, 0.1]]}), path)


def test_a_report_of_a_study_whose_scenario_has_changed_says_what_was_run(tmp_path, funnel_hil):
    scenario, out = tmp_path / "own.yaml", tmp_path / "s"
    scenario.write_text("{extends: paper_arm, name: own, duration_s: 0.1, metrics: {from_s: 0}}")
    (tmp_path / "s.yaml").write_text("{name: s, scenario: own.yaml, grid: {controller.law: [pid]}}")
    assert funnel_hil("sweep", tmp_path / "s.yaml", "--workers", "1", "--out", out)[0] == 0
    before = [(out / name).read_bytes() for name in ("summary.json", "sweep.parquet")]
    (out / "report.html").unlink()
    scenario.write_text("{extends: iiwa, name: other, duration_s: 3}")
    output = funnel_hil.output("report", out)
    assert "scenario own: has changed" in output
    assert [(out / name).read_bytes() for name in ("summary.json", "sweep.parquet")] == before
    assert "other" not in output
    assert "0.1 s" in (out / "report.html").read_text(encoding="utf-8")
    (out / "summary.json").unlink()
    output = funnel_hil.output("report", out, code=2)
    assert "scenario own: has changed" in output

"""Sweeps: every combination once, in any order of the workers' rows."""

from __future__ import annotations

import json
import re

import pytest
import yaml

from controller.laws import LAWS
from deploy.reports.html import write_page
from deploy.reports.studies.results import study_page
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError, read_yaml
from deploy.studies.margin.margin_study import margin_study
from deploy.studies.sweep.sweep import load_sweep
from deploy.study.execution.folder import create_folder, find_folder
from deploy.study.planned_run import row_of
from tests.deploy.study.studies import (
    TIED,
    Here,
    conduct,
    folder_of,
    made_up,
    make_sweep,
    margin_of,
    sweep_of,
)

IMPOSSIBLE = [
    ({"link.uplink.delay": [1]}, {}, ["link.uplink.delay", "unknown key"]),
    ({"controller.law": ["pid", "magic"]}, {}, ["controller.law", "'magic'", *LAWS]),
    ({TIED: []}, {}, [TIED, "[]", "a list of values"]),
    ({TIED: [1, 1]}, {}, [TIED, "different values"]),
    ({TIED: {"from": 0, "to": 1, "step": 0}}, {}, [TIED, "a step above 0"]),
    ({TIED: {"from": 0, "to": 2, "step": 1e-4}}, {}, [TIED, "at most 10000 values", "are 20001"]),
    ({TIED: {"from": 0, "to": 1e300, "step": 1e-300}}, {}, ["at most 10000 values; these are inf"]),
    ({TIED: {"from": 0, "to": 1}}, {}, [TIED, "{from, to, step}"]),
    ({TIED: [1]}, {"seeds": [1, 1]}, ["seeds", "different"]),
]


def test_a_grid_is_every_combination_with_every_seed(tmp_path):
    grid = {TIED: {"from": 0, "to": 1, "step": 0.5}, "controller.law": ["pid", "smc"]}
    sweep = make_sweep(tmp_path, grid, seeds=[4, 9])
    runs = list(sweep.first())
    assert len(runs) == sweep.expected == 3 * 2 * 2
    assert len({run.key for run in runs}) == 12
    last = load_setup(runs[-1].scenario, runs[-1].overrides).scenario
    assert (last.link.uplink.delay_ms, last.link.downlink.delay_ms) == (1.0, 1.0)
    assert last.controller.law == "smc"
    assert [run.seed for run in runs[:2]] == [4, 9]


def test_ranges_include_both_ends_and_do_not_drift(tmp_path):
    sweep = make_sweep(tmp_path, {"link.uplink.delay_ms": {"from": 0, "to": 0.3, "step": 0.1}})
    assert list(sweep.axes.values()) == [[0.0, 0.1, 0.2, 0.3]]


def test_values_of_any_type_are_swept(tmp_path):
    grid = {
        "robot.initial_offset_rad": [[0.1, 0.0, 0.0], 0.05],
        "plant.friction.enabled": [True, False],
    }
    sweep = make_sweep(tmp_path, grid)
    assert sweep.columns == {"robot.initial_offset_rad": "string", "plant.friction.enabled": "bool"}
    first = next(iter(sweep.first()))
    assert load_setup(first.scenario, first.overrides).start_position_rad.shape == (3,)


def test_rows_are_safe_before_a_study_ends(tmp_path):
    sweep = make_sweep(tmp_path, {TIED: [0, 1]}, seeds=2)
    folder = folder_of(sweep, tmp_path / "out")
    runs = list(sweep.first())
    for run in runs[:2]:
        folder.add(run, made_up(run))
        folder.write()
    (tmp_path / "out" / "sweep.parquet.unfinished").write_bytes(b"cut off by a kill")
    again = folder_of(sweep, tmp_path / "out")
    assert [again.find(run) is not None for run in runs] == [True, True, False, False]


def test_every_point_has_its_scenario(tmp_path):
    sweep = make_sweep(tmp_path, {TIED: [0, 1.5]}, seeds=[7, 8])
    _, folder = conduct(sweep, tmp_path / "out", Here(made_up))
    names = sorted(file.name for file in folder.scenarios.iterdir())
    assert names[:2] == ["00000.yaml", "00001.yaml"]
    assert re.fullmatch(r"paper_arm-[0-9a-f]{8}\.urdf", names[2])  # one, for both
    assert len(names) == 3
    command = folder.rerun_command("00001")
    again = load_setup(command.removeprefix("funnel-hil simulate "))
    assert again.scenario.link.uplink.delay_ms == 1.5
    assert again.scenario.seed == 7


def test_a_run_that_fails_is_a_row_and_not_the_end(tmp_path):
    sweep = make_sweep(tmp_path, {"duration_s": [0.1, 0.2]})
    first, _ = sweep.first()
    missing = row_of(type(first)(first.point, "gone.yaml", (), 1, first.columns))
    assert "gone.yaml" in missing["error"]
    workers = Here(lambda run: missing if run.key == first.key else made_up(run))
    whole, folder = conduct(sweep, tmp_path / "out", workers)
    assert whole
    assert [row["error"] is None for row in folder.rows] == [False, True]
    summary = sweep.summary(folder.rows)
    assert summary["completed"]
    assert summary["runs_failed"] == 1


@pytest.mark.parametrize(("grid", "more", "message"), IMPOSSIBLE)
def test_impossible_sweeps_are_refused_with_the_reason(funnel_hil, tmp_path, grid, more, message):
    file = tmp_path / "bad.yaml"
    file.write_text(yaml.safe_dump(sweep_of(grid, **more)))
    output = funnel_hil.output("sweep", file, "--out", tmp_path / "out", code=2)
    assert output.startswith(f"error: {file}")
    assert [word for word in message if word not in output] == []
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "grid",
    [
        {},
        {"controller.law": ["pid", "smc"]},
        {TIED: [0, 1, 2], "controller.model_scale": [0.9, 1.0], "controller.law": ["pid", "smc"]},
    ],
)
def test_every_sweep_has_a_report_that_names_reruns(tmp_path, grid):
    sweep = make_sweep(tmp_path, grid, seeds=2)
    _, folder = conduct(sweep, tmp_path / "out", Here(made_up))
    write_page(folder.report, study_page(sweep.summary(folder.rows), folder))
    page = folder.report.read_text(encoding="utf-8")
    assert 'href="scenarios/00000.yaml"' in page
    assert f"funnel-hil simulate {tmp_path / 'out' / 'scenarios' / '00000'}.yaml" in page
    assert ('id="curve-violation_fraction"' in page) == bool(grid)
    assert page.count('<figure class="card" id="field-worst_rms_rad-') == 2 * (len(grid) == 3)


def test_only_studies_that_a_command_can_take_are_offered(funnel_hil):
    output = {words: funnel_hil(*words, "nowhere") for words in (("sweep",), ("margin", "--study"))}
    assert {code for code, _ in output.values()} == {2}
    offered = [text.partition("the shipped studies ")[2].split() for _, text in output.values()]
    assert offered[0] == ["delay_sweep,", "networks,", "networks_panda"]
    assert "delay_margin," in offered[1]
    assert "delay_sweep," not in offered[1]


def test_the_shipped_sweep_can_be_run():
    assert load_sweep("delay_sweep").expected == 11 * 5 * 2


def test_an_unfinished_study_of_nothing_has_a_report(tmp_path):
    plants = {"plants": 2, "values": [4], "uncertainty": "half"}
    plants_study = margin_study({"laws": ["smc"], **plants}, tmp_path / "m.yaml")
    for study in (make_sweep(tmp_path, {TIED: [0, 1]}), margin_of(), plants_study):
        folder = folder_of(study, tmp_path / study.kind)
        write_page(folder.report, study_page(study.summary([]), folder))
        assert folder.report.is_file()
        assert not study.summary([])["completed"]


def test_a_folder_holds_one_study(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    one, other = make_sweep(tmp_path, {TIED: [0]}), make_sweep(tmp_path, {TIED: [1]})
    path = create_folder(one, tmp_path / "out")
    assert find_folder(one, path) == path
    with pytest.raises(ScenarioError, match=r"study\.yaml"):
        find_folder(other, path)
    assert find_folder(one, None) is None
    begun = create_folder(one, None)
    assert find_folder(one, None) == begun
    values = read_yaml(begun / "study.yaml")
    (begun / "study.yaml").write_text(yaml.safe_dump(values, sort_keys=True))
    assert find_folder(one, None) == begun  # what it says counts, not how
    (tmp_path / "runs" / "sweep-s-broken").mkdir()
    (tmp_path / "runs" / "sweep-s-broken" / "study.yaml").write_text("{")
    assert find_folder(one, None) == begun
    (begun / "summary.json").write_text(json.dumps({"completed": True}))
    assert find_folder(one, None) is None


def test_study_of_plants_is_found_again_with_any_draws(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    draws = {"distribution": "choice", "values": [0.0, 1e-6]}
    more = {"plants": 2, "uncertainty": {"plant.encoder.resolution_rad": draws}}
    begun = create_folder(make_sweep(tmp_path, {TIED: [0]}, **more), None)
    assert find_folder(make_sweep(tmp_path, {TIED: [0]}, **more), None) == begun
    assert find_folder(make_sweep(tmp_path, {TIED: [0, 1]}, **more), begun) == begun


def test_two_commands_do_not_write_to_one_folder(tmp_path):
    sweep = make_sweep(tmp_path, {TIED: [0]})
    first, second = (folder_of(sweep, tmp_path / "out") for _ in range(2))
    first.lock()
    with pytest.raises(ScenarioError, match="another command"):
        second.lock()

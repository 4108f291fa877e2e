"""Margins over uncertain plants: the same plants at every value, under every law."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from deploy.reports.again import read_study
from deploy.reports.html import write_page
from deploy.reports.studies.results import study_page
from deploy.reports.tables import as_markdown
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError, read_yaml
from deploy.studies.margin.margin_study import margin_study
from deploy.studies.robustness.result import RobustnessResult
from deploy.studies.robustness.robustness import Robustness
from deploy.studies.robustness.tables import robustness_table
from deploy.studies.sweep.sweep import Sweep, load_sweep
from deploy.study.definition import SHIPPED
from deploy.study.execution.folder import create_folder
from deploy.study.plants import measured
from tests.deploy.reports.page_order import assert_shows_before_it_tells
from tests.deploy.study.studies import NOISE, TIED, Here, conduct, made_up

PAYLOAD, COULOMB = "plant.payload_kg", "plant.friction.coulomb_nm"
RANGES = {
    PAYLOAD: {"distribution": "uniform", "from": 0, "to": 3},
    COULOMB: {"distribution": "uniform", "from": 0.5, "to": 2, "per": "joint", "relative": True},
}


def robustness_of(**values):
    given = {"laws": ["smc"], "plants": 20, "uncertainty": RANGES, "values": [32, 8, 16], **values}
    return Robustness(given, Path("margin"))


def all_of(**values):
    return robustness_of(exhaustive=True, **values)


def heavy_ones_lost(run):
    """The more delay, the less payload is carried: 3 kg at 8 ms, 1.5 at 16, 0.75 at 32."""
    lost = run.columns[PAYLOAD] * run.columns["value"] > 24.0
    return made_up(run, violation_fraction=0.1 * lost)


def test_every_plant_meets_every_value_under_every_law_and_setting():
    study = all_of(laws=["smc", "pid"], compensation=[False, True], seeds=2, set=NOISE)
    runs = list(study.first())
    assert len(runs) == study.expected == 2 * 2 * 3 * 20
    runs += [more for run in runs for more in study.follow(run, made_up(run))]
    assert len({run.key for run in runs}) == len(runs) == study.expected == 2 * 2 * 3 * 20 * 2
    by_plant = {}
    for run in runs:
        by_plant.setdefault(run.columns["plant"], set()).add(run.columns[PAYLOAD])
    assert len(by_plant) == 20
    assert all(len(payloads) == 1 for payloads in by_plant.values())
    scenario = load_setup(runs[-1].scenario, runs[-1].overrides).scenario
    assert scenario.plant.payload_kg == runs[-1].columns[PAYLOAD]
    assert (scenario.link.uplink.delay_ms, scenario.controller.law) == (16.0, "pid")
    assert scenario.controller.delay_compensation.enabled


def test_more_plants_leave_the_first_ones_as_they_were():
    few, many = (
        {run.columns["plant"]: run.overrides for run in all_of(plants=n).first()} for n in (3, 20)
    )
    assert few == {number: many[number] for number in (1, 2, 3)}
    other = next(iter(all_of(plant_seed=2).first()))
    assert other.overrides != few[1]


def test_factors_are_on_what_the_study_sets():
    study = all_of(set={COULOMB: [1.0, 2.0, 4.0]})
    run = next(iter(study.first()))
    coulomb = load_setup(run.scenario, run.overrides).scenario.plant.friction.coulomb_nm
    np.testing.assert_allclose(coulomb / [1.0, 2.0, 4.0], run.columns[COULOMB], rtol=1e-12)


def test_shares_are_counted_and_losses_ranked(tmp_path):
    study = all_of(kept_share=0.5)
    whole, folder = conduct(study, tmp_path / "out", Here(heavy_ones_lost, seed=3))
    assert whole
    summary = study.summary(folder.rows)
    assert summary["completed"]
    (case,) = summary["cases"]
    payloads = np.array([plant.columns[PAYLOAD] for plant in study.cases[0].variants])
    expected = [int((payloads <= limit).sum()) for limit in (3.0, 1.5, 0.75)]
    assert [value["kept"] for value in case["values"]] == expected
    assert expected[0] == 20
    assert 0 < expected[2] < expected[1] < 20
    enough = [value for value, kept in zip((8, 16, 32), expected, strict=True) if kept >= 10]
    assert case["kept_up_to"] == max(enough)
    assert case["held_arm_ceiling_ms"] == pytest.approx(122.7)
    first = case["losses"]["effects"][0]
    assert (first["quantity"], first["effect"]) == (PAYLOAD, pytest.approx(1.0))
    assert case["losses"]["chance_level"] < 0.9
    # The heaviest plant is not among the worst where none is lost, but is lost at 32 ms.
    lost_at_32 = {int(point.split("-")[2]) for point in case["values"][2]["worst_points"]}
    assert all(payloads[number - 1] > 0.75 for number in lost_at_32)


def test_rows_carry_the_draws_and_points_run_again(tmp_path):
    study = robustness_of(plants=2, values=[8])
    _, folder = conduct(study, tmp_path / "out", Here(heavy_ones_lost))
    rows = folder.rows
    assert [row["plant"] for row in rows] == [1, 2]
    assert len(rows[0][COULOMB]) == 3
    again = load_setup(str(folder.scenarios / f"{rows[1]['point']}.yaml"))
    assert again.scenario.plant.payload_kg == rows[1][PAYLOAD]
    assert folder.rows_file.name == "robustness.parquet"


def test_a_drawn_plant_is_certain(tmp_path):
    file = tmp_path / "own.yaml"
    file.write_text(yaml.safe_dump({"extends": "paper_arm", "uncertainty": RANGES}))
    study = robustness_of(uncertainty=None, scenarios=[str(file)])
    run = next(iter(study.first()))
    assert run.columns[PAYLOAD] == next(iter(robustness_of().first())).columns[PAYLOAD]
    assert load_setup(run.scenario, run.overrides).scenario.uncertainty == {}


def test_draws_are_measured_joint_by_joint_and_to_both_sides():
    ranges = {
        "controller.model_scale": {"distribution": "uniform", "from": 0.7, "to": 1.3},
        "plant.disturbance.scale": {"distribution": "log_uniform", "from": 0.5, "to": 2},
        PAYLOAD: RANGES[PAYLOAD],
        "robot.initial_offset_rad": {"distribution": "uniform", "from": 0.2, "to": 1,
                                     "per": "joint", "relative": True, "random_sign": True},
    }  # fmt: skip
    study = robustness_of(uncertainty=ranges)
    (case,), uncertainty = study.cases, study.definition.uncertainty
    found = {
        one.name: one.values for one in measured(uncertainty, case.variants, case.setting.base)
    }
    joints = ("base_yaw", "shoulder", "elbow")
    # The scenario's own payload, 0, is an end of its range: there is one side only.
    assert list(found) == [
        "controller.model_scale", "controller.model_scale, distance from mid-range",
        "plant.disturbance.scale", "plant.disturbance.scale, distance from mid-range", PAYLOAD,
        *(f"robot.initial_offset_rad, {joint}, {what}"
          for joint in joints for what in ("size", "sign")),
    ]  # fmt: skip
    scale = found["controller.model_scale"]
    distance = found["controller.model_scale, distance from mid-range"]
    np.testing.assert_allclose(distance, abs(scale - 1.0), rtol=1e-12)
    factor = found["plant.disturbance.scale"]
    distance = found["plant.disturbance.scale, distance from mid-range"]
    np.testing.assert_allclose(distance, abs(np.log(factor)), atol=1e-12)
    assert set(found["robot.initial_offset_rad, elbow, sign"]) == {-1.0, 1.0}


def test_a_plant_counts_as_kept_with_every_seed_only(tmp_path):
    study = all_of(plants=4, seeds=2, values=[8], set=NOISE)
    one_seed = Here(lambda run: made_up(
        run, violation_fraction=0.1 * (run.seed == 2 and run.columns["plant"] > 1)))  # fmt: skip
    _, folder = conduct(study, tmp_path / "out", one_seed)
    (value,) = study.summary(folder.rows)["cases"][0]["values"]
    assert (value["kept"], value["total"], value["runs_kept"]) == (1, 4, 5)


def test_plants_that_cannot_start_are_counted(tmp_path):
    study = robustness_of(values=[120, 123], plants=3)
    _, folder = conduct(study, tmp_path / "out", Here(made_up))
    (case,) = study.summary(folder.rows)["cases"]
    # The shipped start leaves the funnel after 122.7 ms, for any payload and friction.
    assert [value["beyond_held_arm_ceiling"] for value in case["values"]] == [0, 3]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"plants": 0}, ["plants", "0", "greater than or equal to 1"]),
        ({"values": []}, ["values", "different values"]),
        ({"kept_share": 2}, ["kept_share", "2", "less than or equal to 1"]),
        ({"uncertainty": None}, ["uncertainty: is needed", "--uncertainty", "paper_arm"]),
        ({"uncertainty": "narrow"}, ["narrow", "shipped ranges full, half"]),
        ({"uncertainty": {PAYLOAD: {"distribution": "uniform"}}}, [PAYLOAD, "from < to"]),
        (
            {"uncertainty": {PAYLOAD: {**RANGES[PAYLOAD], "relative": True}}},
            [PAYLOAD, "must draw different plants", "a factor on 0"],
        ),
        ({"set": {PAYLOAD: 1}}, [PAYLOAD, "must be given once"]),
        ({"quantity": PAYLOAD}, [PAYLOAD, "must be given once"]),
        ({"offsets": [1]}, ["offsets", "left out with plants"]),
        ({"limit": 8}, ["limit", "left out with plants"]),
    ],
)
def test_impossible_studies_are_refused_with_the_reason(values, message):
    given = {"laws": ["smc"], "plants": 2, "uncertainty": RANGES, "values": [8], **values}
    with pytest.raises(ScenarioError) as refusal:
        margin_study(given, Path("own.yaml"))
    assert str(refusal.value).startswith("own.yaml: ")
    assert [word for word in message if word not in str(refusal.value)] == []


def test_a_plant_that_the_scenario_refuses_is_named_with_what_was_drawn():
    wide = {"reference.speed": {"distribution": "uniform", "from": 1, "to": 60}}
    with pytest.raises(ScenarioError, match=r"plant 1: .*reach(.|\n)*reference\.speed"):
        robustness_of(uncertainty=wide)


@pytest.mark.parametrize("file", sorted(SHIPPED.glob("uncertain_*.yaml")), ids=lambda f: f.stem)
def test_shipped_studies_can_be_run(file):
    study = margin_study(read_yaml(file), file)
    assert study.expected == 4 * 6 * 40
    assert all(base.scenario.duration_s == 8.0 for base in study.bases)


def test_a_study_of_plants_is_reported_again(funnel_hil, tmp_path):
    study = all_of()
    path = create_folder(study, tmp_path / "out")
    conduct(study, path, Here(heavy_ones_lost))
    assert read_study(path).definition == study.definition
    output = funnel_hil.output("report", path)
    assert "plants of 20 that kept their bounds, by round trip (ms)" in output
    assert "+1.00" in output
    assert "…" not in output
    assert json.loads((path / "summary.json").read_text())["kind"] == "robustness"
    table = (path / "table.md").read_text().splitlines()
    assert table[0].endswith("| 95 % of 20 kept up to (95 % interval there) | 8 | 16 | 32 |")
    assert table[2].startswith("| paper_arm | smc | 123 ms | 8 ms (84–100 %) | 20 |")
    headline = "20 of 20 plants kept their bounds up to 8 ms; of all such plants 84–100 %"
    assert headline in output
    page = (path / "report.html").read_text()
    assert_shows_before_it_tells(page)
    rerun = f"funnel-hil simulate {path}/scenarios/000-000002-"
    for text in (headline, 'id="kept-paper_arm"', 'id="losses-0"', rerun, "Effect: +1"):
        assert text in page


def test_an_unfinished_study_of_plants_has_a_report(tmp_path):
    study = all_of()
    whole, folder = conduct(study, tmp_path / "out", Here(heavy_ones_lost, at_most=7))
    assert not whole
    summary = study.summary(folder.rows)
    assert not summary["completed"]
    (case,) = summary["cases"]
    assert sum(value["total"] for value in case["values"]) == 7
    assert case["kept_up_to"] is None
    assert "not known yet" in as_markdown(
        robustness_table(RobustnessResult.model_validate(summary))
    )
    write_page(folder.report, study_page(summary, folder))


def test_a_sweep_meets_every_point_with_every_plant(tmp_path):
    values = {"name": "s", "scenario": "paper_arm", "grid": {TIED: [4, 16]}, "plants": 20,
              "uncertainty": RANGES}  # fmt: skip
    sweep = Sweep(values, tmp_path / "s.yaml")
    assert len(list(sweep.first())) == sweep.expected == 40

    def lost(run):
        over = run.columns[PAYLOAD] * run.columns["link.uplink.delay_ms"] > 24.0
        return made_up(run, violation_fraction=0.1 * over)

    _, folder = conduct(sweep, tmp_path / "out", Here(lost))
    summary = sweep.summary(folder.rows)
    payloads = np.array([plant.columns[PAYLOAD] for plant in sweep.plants])
    kept = int((payloads <= 1.5).sum())
    assert [(point["kept"], point["total"]) for point in summary["points"]] == [
        (20, 20),
        (kept, 20),
    ]
    write_page(folder.report, study_page(summary, folder))
    page = folder.report.read_text(encoding="utf-8")
    assert 'id="curve-kept_share"' in page
    assert f"scenarios/{summary['points'][1]['worst_point']}.yaml" in page


def test_a_sweep_takes_plants_from_the_command_line():
    sweep = load_sweep("delay_sweep", {"plants": 3, "uncertainty": "half"} | {"grid": {TIED: [1]}})
    assert sweep.expected == 3
    with pytest.raises(ScenarioError, match=r"controller\.model_scale: must be given once"):
        load_sweep("delay_sweep", {"plants": 3, "uncertainty": "half"})

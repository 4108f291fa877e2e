"""Tunings, benchmarks, data sheets and identifications from Python."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import funnel_hil
from deploy.scenario.scenario import load_setup
from tests.deploy.measure.identify.virtual_logs import excitation, truth_of, write_log

SHORT = {"duration_s": 0.5}


def test_tuning_finds_gains_that_are_no_worse_and_writes_a_scenario_with_them(tmp_path):
    pytest.importorskip("cma", reason="cma is not installed")
    done = funnel_hil.tune(
        "paper_arm", SHORT, laws=["pid"], budget=3, duration_s=0.3, plants=1, out=tmp_path / "t"
    )
    found = done.summary["laws"]["pid"]
    assert found["cost_found"] <= found["cost_start"]
    assert len([row for row in done.rows if row["stage"] == "search"]) == 3 * found_places(done)
    tuned = load_setup(str(tmp_path / "t" / "pid.yaml"))
    for name, values in found["gains"]["found"].items():
        np.testing.assert_allclose(getattr(tuned.gains, name), values)


def found_places(done):
    """Places of the search, where each candidate is run once."""
    return len({row["place"] for row in done.rows if row["stage"] == "search"})


def test_benchmark_has_a_cell_for_each_law_predictor_and_arm(tmp_path):
    arms = ["paper_arm", {"extends": "paper_arm", "name": "other"}]
    done = funnel_hil.benchmark(
        arms, laws=["pid"], predictors=["none", "smith"], delays_ms=[1.0], duration_s=0.2
    )
    cells = {(Path(cell["scenario"]).stem, cell["predictor"]) for cell in done.summary["cells"]}
    assert cells == {(arm, of) for arm in ("paper_arm", "other") for of in ("none", "smith")}
    assert done.summary["completed"]


def test_scenarios_of_one_name_are_refused():
    with pytest.raises(funnel_hil.InputError, match="scenarios: must have different names"):
        funnel_hil.benchmark(["paper_arm", "paper_arm"], laws=["pid"])


def test_data_sheet_quotes_the_margin_of_its_own_search(tmp_path):
    """A law that is stable without a delay alone: every longer one is lost."""
    done = funnel_hil.datasheet(
        "paper_arm", {"duration_s": 0.5}, law="pid", quick=True, out=tmp_path / "sheet"
    )
    margin = done.summary["parts"]["margin"]
    assert done.summary["runs"] == margin["runs"] == len(done.rows)
    assert (tmp_path / "sheet" / "report.html").is_file()
    assert [case["law"] for case in margin["cases"]] == ["pid", "pid"]
    again = funnel_hil.datasheet(
        "paper_arm", {"duration_s": 0.5}, law="pid", quick=True, out=tmp_path / "sheet"
    )
    assert again.rows == done.rows


def test_identification_finds_the_friction_of_a_virtual_robot(tmp_path):
    pytest.importorskip("scipy", reason="the extra identify is not installed")
    random = np.random.default_rng(4)
    robot, model, *_ = excitation("paper_arm", 25.0)
    truth = truth_of(robot, model, random)
    write_log(tmp_path / "log.csv", "paper_arm", truth, random)
    found = funnel_hil.identify([tmp_path / "log.csv"], "paper_arm", out=tmp_path / "arm")
    viscous = [joint["viscous_nm_s"] for joint in found.summary["joints"]]
    for each, true in zip(viscous, truth.viscous, strict=True):
        assert abs(each["value"] - true) < 2.0 * each["half_95"]
    assert funnel_hil.simulate(found.scenario, {"duration_s": 0.1}).faults == []
    assert set(found.figure_names) == {"torques", "friction", "changes"}


def test_unknown_option_of_an_identification_is_refused():
    with pytest.raises(funnel_hil.InputError, match="speed: must be one of columns, unit"):
        funnel_hil.identify([], "paper_arm", speed=1)

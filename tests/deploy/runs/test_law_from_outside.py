"""A law is one line of the table `LAWS`: scenarios, gains and comparisons follow from it."""

from __future__ import annotations

import json
from typing import NamedTuple

import numpy as np
import pytest
import yaml

from bus_schema.configuration import PerJointPositive, Positive
from controller.control_law import Diagnostics
from controller.laws import LAWS, LawEntry
from deploy.runs.simulate import simulate
from deploy.scenario.scenario import load_setup
from deploy.scenario.study_keys import laws_beside
from deploy.scenario.written import effective_scenario
from deploy.scenario.yaml_files import ScenarioError
from deploy.study.margins.margin import MarginDefinition


class ImpedanceGains(NamedTuple):
    """Stiffness in N m per rad and joint; damping as a share of the critical one for 1 kg m²."""

    stiffness: PerJointPositive
    damping_ratio: Positive = 1.0

    @classmethod
    def from_inertia(cls, inertia_kg_m2):
        return cls(900.0 * inertia_kg_m2)


class Impedance:
    """Springs and dampers about the reference, on top of the torque that follows it."""

    def __init__(self, gains, model, torque_limits_nm):
        self.gains, self.model = gains, model
        self.diagnostics = Diagnostics(torque_limits_nm.size)

    def reset(self):
        pass

    def torque(self, tracking):
        feedback = self.gains.stiffness * tracking.error
        damping = 2.0 * self.gains.damping_ratio * np.sqrt(self.gains.stiffness)
        feedback = feedback + damping * tracking.error_rate
        ahead = tracking.reference_acceleration
        return self.model.inverse_dynamics(tracking.position, tracking.velocity, ahead) - feedback


@pytest.fixture
def added(monkeypatch):
    monkeypatch.setitem(LAWS, "impedance", LawEntry(Impedance, ImpedanceGains))


def setup_of(*overrides, law="impedance", duration_s=1.0):
    return load_setup(
        "paper_arm", [f"controller.law={law}", f"duration_s={duration_s}", *overrides]
    )


@pytest.mark.usefixtures("added")
def test_its_gains_come_from_the_scenario_and_are_written_out_again(tmp_path):
    gains = "controller.gains.impedance={stiffness: [6000, 11000, 900], damping_ratio: 2}"
    setup = setup_of(gains)
    assert setup.gains.stiffness.tolist() == [6000.0, 11000.0, 900.0]
    simulation = simulate(setup)
    errors = simulation.data().true_errors_rad
    assert np.abs(errors[-1]).max() < 0.05 < np.abs(errors[0]).max()
    file = tmp_path / "effective.yaml"
    file.write_text(effective_scenario(setup))
    written = yaml.safe_load(file.read_text())["controller"]["gains"]
    assert written["impedance"] == {"stiffness": [6000.0, 11000.0, 900.0], "damping_ratio": 2.0}
    assert simulate(load_setup(str(file))).data().digest == simulation.data().digest


@pytest.mark.usefixtures("added")
def test_without_gains_in_the_scenario_they_come_from_the_arm():
    stiffness = setup_of().gains.stiffness
    assert stiffness.shape == (3,)
    assert len(set(stiffness.tolist())) == 3


@pytest.mark.parametrize(
    ("override", "told"),
    [
        ("controller.gains.impedance.stiffness=-1", "= -1: must be numbers above 0"),
        (
            "controller.gains.impedance={stiffness: 1, stifness: 2}",
            "stifness: there is no such key",
        ),
        ("controller.gains.impedance.damping_ratio=1", "impedance.stiffness: is missing"),
        ("controller.gains.impedance.stiffness=[1, 2]", "one for each of the 3 joints"),
        ("controller.gains.admittance={}", "admittance: there is no such key"),
        ("controller.law=magic", "'magic': must be one of fixed_time_neural,"),
        ("controller.law=magic", ", ftsmc, impedance, module:Class"),
    ],
)
@pytest.mark.usefixtures("added")
def test_what_is_wrong_with_its_gains_is_told_as_for_any_law(override, told):
    with pytest.raises(ScenarioError, match=r": controller\.") as refused:
        setup_of(override)
    assert told in str(refused.value)


def test_gains_of_a_law_that_is_not_in_the_table_are_refused():
    with pytest.raises(ScenarioError, match=r"gains\.impedance: there is no such key"):
        setup_of("controller.gains.impedance.stiffness=1", law="pid")


@pytest.mark.usefixtures("added")
def test_it_is_compared_and_has_margins_with_all_others(funnel_hil, tmp_path):
    assert MarginDefinition().laws is None  # all there are
    assert "impedance" in laws_beside("pid")
    code, output = funnel_hil(
        "compare", "--laws", "impedance,pid", "--set", "duration_s=0.3",
        "--set", "metrics.from_s=0.1", "--set", "controller.gains.impedance.stiffness=5000",
        "--out", tmp_path,
    )  # fmt: skip
    assert code == 0
    assert "impedance" in output
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert list(summary["laws"]) == ["impedance", "pid"]
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    assert manifest["gains"]["impedance"]["stiffness"] == [5000.0] * 3

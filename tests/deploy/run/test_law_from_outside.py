"""A law is one line of the table `LAWS`: scenarios, gains and comparisons follow from it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
import yaml

from bus_schema.configuration import PerJointPositive, Positive
from controller.control_law import Diagnostics
from controller.laws import LAWS, LawEntry
from deploy.run.simulate import simulate
from deploy.scenario.effective import effective_scenario
from deploy.scenario.scenario import load_setup


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

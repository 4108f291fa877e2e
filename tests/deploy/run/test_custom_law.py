"""Custom laws: a module and class, named in a scenario."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import controller
from controller.control_law import Diagnostics
from deploy.run.simulate import simulate
from deploy.scenario.effective import effective_scenario
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError

SOURCE = """
import numpy as np
from controller.control_law import Diagnostics

class ComputedTorque:
    def __init__(self, model, stiffness=100.0):
        self.diagnostics = Diagnostics(model.joints)
        self.model, self.stiffness = model, stiffness

    def reset(self):
        pass

    def torque(self, tracking):
        damping = 2.0 * self.stiffness**0.5
        wanted = tracking.reference_acceleration - self.stiffness * tracking.error
        wanted = wanted - damping * tracking.error_rate
        return self.model.inverse_dynamics(tracking.position, tracking.velocity, wanted)

class NotMade:
    def __init__(self, model):
        [][model.joints]

class NoLaw:
    def __init__(self, model):
        pass

number = 3
"""


@pytest.fixture(autouse=True)
def folder(import_folder):
    (import_folder / "my_laws.py").write_text(SOURCE)
    (import_folder / "broken_module.py").write_text("1 / 0\n")
    return import_folder


def setup_of(law, *overrides, duration_s=0.5):
    return load_setup(
        "paper_arm", [f"controller.law={law}", f"duration_s={duration_s}", *overrides]
    )


def test_custom_law_follows_the_reference_and_reads_its_gains(folder):
    setup = setup_of(
        "my_laws:ComputedTorque", "controller.gains.custom={stiffness: 400.0}", duration_s=2
    )
    assert setup.gains == {"stiffness": 400.0}
    simulation = simulate(setup)
    assert simulation.failure is None
    errors = simulation.data().true_errors_rad
    assert np.abs(errors[-1]).max() < 0.05 < np.abs(errors[0]).max()
    file = folder / "effective.yaml"
    file.write_text(effective_scenario(setup))
    assert simulate(load_setup(str(file))).data().digest == simulation.data().digest


@pytest.mark.parametrize(
    ("law", "gains", "message"),
    [
        ("nowhere:Law", "{}", "nowhere cannot be imported: ModuleNotFoundError"),
        ("broken_module:Law", "{}", "broken_module cannot be imported: ZeroDivisionError"),
        ("broken_module:Law", "{}", "broken_module.py:1 in <module>)"),
        ("my_laws:NotMade", "{}", "IndexError: list index out of range ("),
        ("my_laws:NotMade", "{}", "my_laws.py:21 in __init__)"),
        ("my_laws:Missing", "{}", "my_laws has no class Missing"),
        ("my_laws:number", "{}", "my_laws has no class number"),
        ("my_laws:NoLaw", "{}", "is not a control law: it lacks torque, reset, diagnostics"),
        ("my_laws:NoLaw", "{}", "a law of positions or velocities has target instead of torque"),
        ("my_laws:ComputedTorque", "{stifness: 1}", "cannot be created with these: TypeError"),
        ("not a law", "{}", "must be one of fixed_time_neural"),
    ],
)
def test_unusable_law_is_refused_before_the_run(law, gains, message):
    with pytest.raises(ScenarioError, match=r"--set controller\.") as refused:
        setup_of(law, f"controller.gains.custom={gains}")
    assert message in str(refused.value)


class TargetsAlone:
    """The reference as targets, and no method ``torque``."""

    def __init__(self, model, share=1.0):
        self.diagnostics, self._share, self.resets = Diagnostics(model.joints), share, 0

    def reset(self):
        self.resets += 1

    def target(self, tracking):
        return np.stack([tracking.reference_position, self._share * tracking.reference_velocity])


class TargetsWithZeroTorque(TargetsAlone):
    def torque(self, tracking):
        return np.zeros_like(tracking.error)


ROBOT = ("plant.interface.kind=servoj", "robot.initial_offset_rad=0", "duration_s=0.3")


def law_of_targets(name, *overrides):
    law = f"controller.law=tests.deploy.run.test_custom_law:{name}"
    return load_setup("paper_arm", [law, *overrides])


@pytest.mark.parametrize("more", [(), ("controller.chunks={horizon: 1}",)])
def test_a_law_of_targets_needs_no_torque(more):
    """It drives a robot with the bits of the same law that returns zero torques."""
    alone, both = (
        simulate(law_of_targets(name, *ROBOT, *more)).data()
        for name in ("TargetsAlone", "TargetsWithZeroTorque")
    )
    assert alone.motion == both.motion
    assert np.ptp(alone.tables["plant_truth"]["position"], axis=0).max() > 0.01


def test_a_law_of_targets_is_refused_where_only_torques_are_taken():
    with pytest.raises(ScenarioError, match="must have a method torque beside target, unless"):
        law_of_targets("TargetsAlone")
    law_of_targets("TargetsAlone", "controller.drive_feedback.enabled=true")


class WrongDiagnostics(TargetsAlone):
    def __init__(self, model):
        super().__init__(model)
        self.diagnostics = {"x": 1}


def test_diagnostics_of_another_kind_are_refused():
    with pytest.raises(ScenarioError, match=r"lacks diagnostics, .*Diagnostics, not dict$"):
        law_of_targets("WrongDiagnostics", *ROBOT)


class NewDiagnostics(TargetsAlone):
    """Its diagnostics are other ones after a reset; they count its answers."""

    def reset(self):
        self.diagnostics = Diagnostics(2)
        self.diagnostics.network_norm[0] = 0.0

    def target(self, tracking):
        self.diagnostics.network_norm[0] += 1.0
        return super().target(tracking)


class NewDiagnosticsOfTorques:
    """The same, for a law of torques."""

    def __init__(self, model):
        self.diagnostics = Diagnostics(model.joints)

    reset = NewDiagnostics.reset

    def torque(self, tracking):
        self.diagnostics.network_norm[0] += 1.0
        return np.zeros_like(tracking.error)


@pytest.mark.parametrize("more", [(), ("controller.chunks={horizon: 1}",)])
@pytest.mark.parametrize("name", ["NewDiagnostics", "NewDiagnosticsOfTorques"])
def test_new_diagnostics_after_a_reset_are_published(name, more):
    status = simulate(law_of_targets(name, *ROBOT, *more)).data().tables["control_status"]
    assert np.nanmax(status["network_norm"]) > 10


def test_law_of_the_tutorial_runs_as_shown(folder):
    page = Path(controller.__file__).parents[1] / "deploy/docs/tutorials/your-law.md"
    law = page.read_text().partition(":caption: my_laws.py\n\n")[2].split("```")[0]
    (folder / "law_of_the_tutorial.py").write_text(law)
    custom = "controller.gains.custom={stiffness: 400.0, damping: 40.0}"
    simulation = simulate(setup_of("law_of_the_tutorial:ComputedTorque", custom, duration_s=2))
    assert np.abs(simulation.data().true_errors_rad[-1]).max() < 0.05


def test_a_law_that_cannot_make_up_for_a_lag_is_refused(import_folder):
    (import_folder / "no_lead.py").write_text(
        SOURCE + "\nclass Late(ComputedTorque):\n"
        "    def make_up_for(self, lag_s):\n        raise ValueError('too late')\n"
    )
    with pytest.raises(ScenarioError, match=r"make_up_for.*too late"):
        load_setup(
            "paper_arm",
            ["controller.law=no_lead:Late", "plant.interface.kind=servoj",
             "robot.initial_offset_rad=0"],
        )  # fmt: skip

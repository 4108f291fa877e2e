"""Verdicts on Bullet and on pinocchio with RK4, side by side."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from bus_schema.drive_feedback import no_drive_feedback
from bus_schema.limits import LimitsConfiguration
from controller.manipulator_model import ManipulatorModel
from deploy.experiments.independent_check import (
    Comparison,
    Verdict,
    check_physics_can_be_replaced,
    compare,
    files_of,
    rows,
)
from deploy.experiments.runge_kutta_arm import RungeKuttaArm
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError
from plant_emulator.arm.joint_torques import JointTorques

UNDISTURBED = ["plant.friction.enabled=false", "plant.disturbance.enabled=false"]


def test_undisturbed_run_is_kept_on_both_by_the_same_margin() -> None:
    found = compare("paper_arm", load_setup("paper_arm", [*UNDISTURBED, "duration_s=1"]))
    assert found.bullet.kept
    assert found.runge_kutta.kept
    assert found.agrees
    assert not found.is_marginal
    assert found.runge_kutta.margin_min == pytest.approx(found.bullet.margin_min, abs=0.01)


def test_payload_lag_and_delay_reach_both() -> None:
    hard = ["plant.payload_kg=2", "plant.actuator.lag_ms=3", "link.uplink.delay_ms=20"]
    found = compare("paper_arm", load_setup("paper_arm", [*hard, "duration_s=1"]))
    assert not found.bullet.kept
    assert not found.runge_kutta.kept


def test_energy_of_a_swinging_arm_is_kept_to_the_fourth_order() -> None:
    """A quarter of a second of free fall from rest."""
    setup = load_setup("paper_arm", UNDISTURBED)
    torques = JointTorques(
        setup.scenario.plant, setup.robot, setup.grid.substep_s,
        np.random.default_rng(0), LimitsConfiguration(), no_drive_feedback(setup.robot.joints),
    )  # fmt: skip
    arm = RungeKuttaArm(setup.robot, setup.grid, torques)
    model = ManipulatorModel(setup.robot)
    arm.place(np.array([0.3, -0.5, 1.0]))
    before = model.energy(arm.position, arm.velocity)
    arm.advance(0, 250 * setup.grid.substeps)
    swing = 0.5 * arm.velocity @ model.mass_matrix(arm.position) @ arm.velocity
    assert swing > 1.0
    assert model.energy(arm.position, arm.velocity) == pytest.approx(before, abs=1e-8 * swing)


@pytest.mark.parametrize(
    ("margins", "is_marginal"),
    [((0.2, 0.19), False), ((0.031, 0.04), False), ((0.2, -0.01), True), ((None, -0.5), False)],
)
def test_margins_near_zero_decide_nothing(
    margins: tuple[float | None, float | None], is_marginal: bool
) -> None:
    verdicts = [Verdict(margin is not None and margin > 0, margin, []) for margin in margins]
    assert Comparison("any", *verdicts).is_marginal is is_marginal


def test_table_says_where_they_differ() -> None:
    found = Comparison("p-7", Verdict(True, 0.1234, []), Verdict(False, -0.02, []))
    assert list(rows(iter([found])))[2] == "| p-7 | kept | 12.3 % | lost | -2.0 % | **no** | yes |"


def test_patterns_stand_for_files(tmp_path: Path) -> None:
    for name in ("b.yaml", "a.yaml", "c.txt"):
        (tmp_path / name).touch()
    assert files_of([f"{tmp_path}/*.yaml", "paper_arm"]) == [
        f"{tmp_path}/a.yaml", f"{tmp_path}/b.yaml", "paper_arm",
    ]  # fmt: skip
    with pytest.raises(ScenarioError, match="must fit one file or more"):
        files_of([f"{tmp_path}/*.json"])


def test_arm_with_drives_is_refused() -> None:
    with pytest.raises(ScenarioError, match=r"link.kind = 'can': must be zenoh or in_process"):
        check_physics_can_be_replaced(load_setup("paper_arm_can"))


def test_command_prints_the_table_and_writes_what_is_behind_it(tmp_path: Path) -> None:
    words = ["paper_arm", "--set", "duration_s=0.5", "--json", str(tmp_path / "found.json")]
    done = subprocess.run(
        [sys.executable, "-m", "deploy.experiments.independent_check", *words],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[2].startswith("| paper_arm | kept | ")
    (scenario,) = json.loads((tmp_path / "found.json").read_text())["scenarios"]
    assert scenario["bullet"]["kept"]
    assert scenario["runge_kutta"]["kept"]

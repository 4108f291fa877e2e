"""All arms of pybullet_data, and of example-robot-data where it is installed."""

import importlib.metadata
from pathlib import Path

import numpy as np
import pytest

from bus_schema.errors import RobotDescriptionError
from bus_schema.messages.topics import PLANT_TRUTH
from bus_schema.robot_description import load_robot
from deploy.cli.robot import at_rest
from deploy.run.simulate import simulate
from deploy.scenario.yaml_files import ScenarioError
from plant_emulator.physics.engines import ENGINES
from tests.arms import PYBULLET_DATA, needs_pybullet_data

REASONS = (
    "cannot be read as URDF",
    "has no revolute, continuous or prismatic joint",
    "which xacro has not expanded",
    "must be three numbers",
    "is not a finite number",
    ": lower must be less than upper",
    "and the links fixed to it have no inertia",
    "robot.repair: true",
    "must be a joint that turns or slides",
    "must be at most 1e+09",
    "there must be 1 to 127",
    "must move some mass off its axis",
    "an arm must be fixed to the world",
    "only a tree of bodies can be emulated",
    "MuJoCo: required attribute missing: 'pos': <inertial mass='10'>",
    "MuJoCo: global coordinates no longer supported",
    "MuJoCo: invalid keyword: 'fixed'",
    "MuJoCo: joint 'left_hip_y' not found in tendon 0",  # a fragment
)
if not ENGINES["bullet"].is_installed:
    REASONS += ("MuJoCo: Error: ",)  # of masses and inertias that Bullet takes


def pybullet_urdfs():
    # A thousand single objects of no joint: one of them stands for all.
    return [
        path
        for path in sorted(PYBULLET_DATA.rglob("*.urdf"))
        if "random_urdfs" not in path.parts or path.name == "000.urdf"
    ]


def example_urdfs():
    try:
        files = importlib.metadata.files("example-robot-data") or ()
    except importlib.metadata.PackageNotFoundError:
        return []
    return sorted(Path(str(file.locate())) for file in files if file.suffix == ".urdf")


def outcome(path):
    """Number of driven joints of an arm that was simulated for a moment; the reason if refused."""
    try:
        setup = at_rest(load_robot(path), duration_s=0.005)
    except (RobotDescriptionError, ScenarioError) as error:
        assert str(path) in str(error)
        return str(error)
    data = simulate(setup).data()
    assert data.faults() == [], path
    assert np.isfinite(data.tables[PLANT_TRUTH.name]["position"]).all()
    return setup.robot.joints


def check_all(paths):
    """Simulate each or see why not; how many were simulated."""
    outcomes = {path: outcome(path) for path in paths}
    refused = {path: text for path, text in outcomes.items() if isinstance(text, str)}
    for path, text in refused.items():
        assert any(reason in text for reason in REASONS), (path, text)
    return len(outcomes) - len(refused)


@needs_pybullet_data
def test_all_urdfs_of_pybullet_data_are_simulated_or_refused_with_the_reason():
    assert check_all(pybullet_urdfs()) >= 36


@needs_pybullet_data
def test_all_mjcf_files_of_pybullet_data_are_simulated_or_refused_with_the_reason():
    assert check_all(sorted((PYBULLET_DATA / "mjcf").glob("*.xml"))) >= 8


@pytest.mark.skipif(not example_urdfs(), reason="example-robot-data is not installed")
def test_all_urdfs_of_example_robot_data_are_simulated_or_refused_with_the_reason():
    assert check_all(example_urdfs()) >= 48

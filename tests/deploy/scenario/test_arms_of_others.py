"""All arms of pybullet_data, and of example-robot-data where it is installed."""

import importlib.metadata
import importlib.util
import re
from pathlib import Path

import numpy as np
import pytest

from bus_schema.errors import RobotDescriptionError
from bus_schema.robot_description import load_robot
from deploy.cli.robot import at_rest
from deploy.runs.simulate import simulate
from deploy.scenario.yaml_files import ScenarioError

REASONS = (
    "cannot be read as URDF",
    "has no revolute or continuous joint, nor a prismatic one",
    "which xacro has not expanded",
    "must be three numbers",
    "is no finite number",
    "has no room between",
    "has no inertia, nor has any link fixed to it",
    "robot.repair: true",
    "must be a joint that turns or slides",
    "must be at most 1e+09",
    "must move some mass off its axis",
)
STEP = {"duration_s": 0.005}


def pybullet_urdfs():
    folder = Path(next(iter(importlib.util.find_spec("pybullet_data").submodule_search_locations)))
    # A thousand single objects of no joint: one of them stands for all.
    return [
        path
        for path in sorted(folder.rglob("*.urdf"))
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
        setup = at_rest(load_robot(path), None, repair=False, duration_s=0.005)
    except (RobotDescriptionError, ScenarioError) as error:
        assert str(path) in str(error)
        return str(error)
    data = simulate(setup).data()
    truth = data.tables["plant_truth"]["position"]
    assert np.isfinite(truth).all()
    return setup.robot.joints

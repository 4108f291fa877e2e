"""Arms as their vendors ship them, which lie beside the repository where there are any."""

from pathlib import Path

import numpy as np
import pytest

from bus_schema.robot_description import load_robot
from controller.manipulator_model import ManipulatorModel, spread_positions
from deploy.cli.robot import at_rest

ARMS = Path(__file__).parents[4] / "shared/arms"
pytestmark = pytest.mark.skipif(
    not ARMS.is_dir(), reason="arms of others are not beside the repository"
)

UR = "04-ur/Universal_Robots_ROS2_Description/urdf/ur.urdf.xacro"
XARM = "01-xarm7-lite6/xarm_description/urdf/xarm_device.urdf.xacro"


@pytest.mark.parametrize(
    ("file", "arguments", "joints", "estimated"),
    [
        (UR, {"name": "ur", "ur_type": "ur10e"}, 6, False),
        (XARM, {"dof": "7"}, 7, False),
        (XARM, {"dof": "6", "robot_type": "lite"}, 6, False),
        ("16-ar4/annin_ar4_description/urdf/ar.urdf.xacro", {"ar_model": "mk3"}, 6, False),
        ("02-openarm/openarm_description/urdf/robot/v10.urdf.xacro", {}, 7, False),
        ("08-sawyer/sawyer_description/urdf/sawyer.urdf.xacro", {}, 8, False),
        ("10-abb/abb_irb2400_support/urdf/irb2400.xacro", {}, 6, True),
        ("20-doosan/dsr_description2/xacro/m1013.urdf.xacro", {}, 6, False),
    ],
)
def test_file_is_read_as_it_is(file, arguments, joints, estimated):
    robot = load_robot(ARMS / file, arguments=arguments)
    assert at_rest(robot).robot.joints == joints
    assert bool(robot.estimated) is estimated


def test_ur5e_weighs_what_its_vendor_says():
    robot = load_robot(ARMS / UR, arguments={"name": "ur", "ur_type": "ur5e"})
    model = ManipulatorModel(robot)
    torques = np.abs([model.gravity(each) for each in spread_positions(robot)]).max(axis=0)
    assert robot.effort_limits_nm[1] == 150.0
    assert torques[1] == pytest.approx(60.0, abs=1.5)

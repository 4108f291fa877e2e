"""Joints that are held at a given pose: model and engines have the arm in that pose."""

from contextlib import closing

import numpy as np
import pytest
from test_any_joint import STEP_S, joint, mimic, write

from bus_schema.errors import JointNameError, RobotDescriptionError
from bus_schema.robot_description import load_robot
from controller.manipulator_model import ManipulatorModel
from deploy.scenario.effective import effective_scenario
from deploy.scenario.scenario import build_setup
from deploy.scenario.starter import starter_scenario
from tests.arms import INSTALLED, FreeArm, forward_dynamics

POSE = {"lift": 0.3, "turn": -0.7}
MJCF = """<mujoco><worldbody>
<body name="b" pos="0.3 0.1 0.05" euler="0.2 0.1 0"><joint name="turn" axis="0 1 0" ref="0.2"/>
<inertial pos="0.15 0.02 0" mass="3" diaginertia="0.02 0.03 0.04"/>
<body name="c" pos="0.3 0.1 0.05"><joint name="lift" type="slide" axis="1 0 2" range="-1 1"/>
<inertial pos="0.1 0 0" mass="2" diaginertia="0.02 0.03 0.04"/>
<body name="d" pos="0.3 0 0" euler="0.3 0 0"><joint name="swing" axis="0 1 0"/>
<inertial pos="0.2 0 0" mass="1" diaginertia="0.02 0.03 0.04"/>
</body></body></body></worldbody></mujoco>"""


@pytest.fixture
def file(tmp_path):
    """A lift and a turn, then a swing and a finger that follows the turn."""
    return write(
        tmp_path,
        joint("lift", "prismatic", "a", "b", "1 0 2"),
        joint("turn", "revolute", "b", "c", "0 1 1"),
        joint("swing", "revolute", "c", "d", "0 1 0"),
        joint("finger", "revolute", "d", "e", "0 1 0", mimic("turn", 0.5, 0.1)),
    )


def assert_is_whole_arm_in_pose(held, whole):
    """Of the whole arm's terms, those of the swing, with the other joints in their pose."""
    assert held.joint_names == ("swing",)
    model, full = ManipulatorModel(held), ManipulatorModel(whole)
    (place,) = (number for number, name in enumerate(whole.joint_names) if name == "swing")
    for angle in (-0.8, 0.0, 1.1):
        position = np.array([{**POSE, "swing": angle}[name] for name in whole.joint_names])
        mass, gravity = full.mass_matrix(position), full.gravity(position)
        np.testing.assert_allclose(model.mass_matrix(np.array([angle])), mass[place, place])
        np.testing.assert_allclose(model.gravity(np.array([angle])), gravity[place], atol=1e-12)


def test_model_has_the_arm_in_the_pose(file):
    assert_is_whole_arm_in_pose(load_robot(file, hold=POSE), load_robot(file))


def test_mjcf_has_the_arm_in_the_pose(tmp_path):
    (tmp_path / "arm.xml").write_text(MJCF)
    file = tmp_path / "arm.xml"
    assert_is_whole_arm_in_pose(load_robot(file, hold=POSE), load_robot(file))


@pytest.mark.parametrize("engine", INSTALLED)
def test_engines_have_the_arm_in_the_pose(file, engine):
    robot, still = load_robot(file, ["swing"], hold=POSE), np.zeros(1)
    with closing(FreeArm(robot, engine, STEP_S)) as arm:
        for angle in (np.array([-0.8]), np.array([1.1])):
            expected = forward_dynamics(ManipulatorModel(robot), angle, still, still)
            np.testing.assert_allclose(arm.acceleration(angle, still), expected, rtol=1e-3)


def test_scenario_and_the_copy_of_a_run_keep_the_pose(file, tmp_path):
    robot = load_robot(file, hold=POSE)
    setup = build_setup(starter_scenario(robot), tmp_path / "s.yaml")
    assert setup.robot.text == robot.text
    assert setup.scenario.robot.hold == POSE
    (tmp_path / "copy.urdf").write_text(setup.robot.text)
    copy = load_robot(tmp_path / "copy.urdf", robot.joint_names)
    angle = np.array([0.4])
    assert ManipulatorModel(copy).gravity(angle) == ManipulatorModel(robot).gravity(angle)
    assert "lift" not in effective_scenario(setup, {"robot.urdf": "copy.urdf"})


@pytest.mark.parametrize(
    ("driven", "pose", "said"),
    [
        (None, {"swing": 2.5}, r"robot\.hold: swing: 2\.5: must be -2 to 2"),
        (None, {"swimg": 0.5}, r"robot\.hold must be some of .*'swimg'.*swing"),
        (None, {"finger": 0.5}, r"robot\.hold must be some of .*'finger'"),
        (["swing"], {"swing": 0.5}, r"robot\.hold must be some of lift, turn; not 'swing'"),
    ],
)
def test_pose_that_is_none_is_refused(file, driven, pose, said):
    with pytest.raises((JointNameError, RobotDescriptionError), match=said):
        load_robot(file, driven, hold=pose)

import re

import numpy as np
import pytest

from bus_schema.robot_description import load_robot
from controller.manipulator_model import ManipulatorModel
from tests.arms import PAPER_ARM, forward_dynamics, listed_from_the_tip

SAMPLES = 20


def states(robot):
    """Random positions in range with velocities of either sign, rad/s."""
    random = np.random.default_rng(3)
    for _ in range(SAMPLES):
        yield random.uniform(robot.lower_rad, robot.upper_rad), random.uniform(-2, 2, robot.joints)


def test_equation_of_motion_is_the_sum_of_its_terms(robot):
    model = ManipulatorModel(robot)
    for position, velocity in states(robot):
        acceleration = np.sin(1.0 + np.arange(robot.joints))
        bare = model.inverse_dynamics(position, velocity, 0.0 * acceleration)
        torque = model.inverse_dynamics(position, velocity, acceleration)
        inertia = model.mass_matrix(position)
        np.testing.assert_allclose(inertia @ acceleration + bare, torque, atol=1e-10)
        along = model.torque_along(position, velocity, velocity, acceleration)
        np.testing.assert_allclose(along, torque, atol=1e-10)
        rest = np.zeros(robot.joints)
        still = model.inverse_dynamics(position, rest, rest)
        np.testing.assert_allclose(model.gravity(position), still, atol=1e-10)


@pytest.mark.parametrize("scale", [0.5, 1.3])
def test_scale_multiplies_all_masses_and_inertias(robot, scale):
    nominal, scaled = ManipulatorModel(robot), ManipulatorModel(robot, scale=scale)
    for position, velocity in states(robot):
        full, part = nominal.mass_matrix(position), scaled.mass_matrix(position)
        np.testing.assert_allclose(part, scale * full, atol=1e-12)
        np.testing.assert_allclose(
            scaled.gravity(position), scale * nominal.gravity(position), atol=1e-11
        )
        acceleration = np.ones(robot.joints)
        np.testing.assert_allclose(
            scaled.inverse_dynamics(position, velocity, acceleration),
            scale * nominal.inverse_dynamics(position, velocity, acceleration),
            atol=1e-10,
        )


def test_scale_leaves_the_payload_as_it_is(robot):
    for position, _ in list(states(robot))[:3]:
        pull = ManipulatorModel(robot, payload_kg=2.0).gravity(position)
        pull -= ManipulatorModel(robot).gravity(position)
        scaled = ManipulatorModel(robot, scale=0.5, payload_kg=2.0)
        expected = 0.5 * ManipulatorModel(robot).gravity(position) + pull
        np.testing.assert_allclose(scaled.gravity(position), expected, atol=1e-11)


def test_joints_keep_the_order_of_the_file(tmp_path):
    """pinocchio numbers joints from the base; a file may list them from the tip."""
    path = listed_from_the_tip(PAPER_ARM.path, tmp_path)
    forward, backward = ManipulatorModel(PAPER_ARM), ManipulatorModel(load_robot(path))
    assert load_robot(path).joint_names == ("elbow", "shoulder", "base_yaw")
    for position, velocity in states(PAPER_ARM):
        inertia = forward.mass_matrix(position)[::-1, ::-1]
        np.testing.assert_allclose(backward.mass_matrix(position[::-1]), inertia, atol=1e-12)
        acceleration = forward_dynamics(forward, position, velocity, velocity)[::-1]
        reverse = forward_dynamics(backward, position[::-1], velocity[::-1], velocity[::-1])
        np.testing.assert_allclose(reverse, acceleration, atol=1e-10)
        torque = forward.torque_along(position, velocity, 2.0 * position, velocity)[::-1]
        reverse = backward.torque_along(
            position[::-1], velocity[::-1], 2.0 * position[::-1], velocity[::-1]
        )
        np.testing.assert_allclose(reverse, torque, atol=1e-12)
        np.testing.assert_allclose(
            backward.tip_position(position[::-1]), forward.tip_position(position), atol=1e-12
        )


def test_tips_of_many_postures_are_those_of_pinocchio(robot):
    model = ManipulatorModel(robot)
    positions = np.array([position for position, _ in states(robot)])
    expected = [model.tip_position(position) for position in positions]
    np.testing.assert_allclose(model.tip_positions(positions), expected, atol=1e-14)


SLIDER = """<robot name="slider">
<link name="base"/><link name="mast"/><link name="arm"/><link name="hand"/>
<joint name="turn" type="revolute"><parent link="base"/><child link="mast"/><axis xyz="0 0 1"/>
  <origin xyz="0 0 0.5" rpy="0 0.3 0"/><limit lower="-2" upper="2" effort="9" velocity="9"/></joint>
<joint name="lift" type="prismatic"><parent link="mast"/><child link="arm"/><axis xyz="0 0.6 0.8"/>
  <origin xyz="0.1 0 0"/><mimic joint="turn" multiplier="-0.5" offset="0.05"/>
  <limit lower="-2" upper="2" effort="9" velocity="9"/></joint>
<joint name="bend" type="revolute"><parent link="arm"/><child link="hand"/><axis xyz="0 1 0"/>
  <origin xyz="0.4 0 0"/><limit lower="-2" upper="2" effort="9" velocity="9"/></joint>
</robot>"""


def test_tips_of_arms_with_sliding_followers_are_those_of_pinocchio(tmp_path):
    inertia = '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
    body = f'<inertial><mass value="1"/>{inertia}</inertial>'
    text = re.sub(r'<link name="(\w+)"/>', rf'<link name="\1">{body}</link>', SLIDER)
    (tmp_path / "slider.urdf").write_text(text)
    robot = load_robot(tmp_path / "slider.urdf")
    assert robot.joint_names == ("turn", "bend")
    model = ManipulatorModel(robot)
    positions = np.array([position for position, _ in states(robot)])
    expected = [model.tip_position(position) for position in positions]
    np.testing.assert_allclose(model.tip_positions(positions), expected, atol=1e-14)

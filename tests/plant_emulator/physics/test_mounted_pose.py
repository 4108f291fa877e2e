"""A mounted arm falls, looks and is modelled as the same arm under a turned gravity."""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pinocchio
import pytest

from bus_schema.errors import RobotDescriptionError
from bus_schema.robot_description import load_robot
from bus_schema.view.arm_view import LinkPoses
from controller.manipulator_model import ManipulatorModel
from controller.rigid_bodies.dynamics import mass_and_load
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError
from tests.arms import ARMS, INSTALLED, PAPER_ARM, FreeArm, forward_dynamics, shipped_arm

MOUNTS = [(np.pi / 2, 0.0, 0.0), (0.4, -1.1, 2.0), (np.pi, 0.0, 0.0)]


def turned_gravity(robot, base_rpy_rad, position):
    """Torques that hold an upright arm if gravity points elsewhere, by pinocchio alone."""
    model = pinocchio.buildModelFromXML(robot.resolved_urdf(shapes="none"))
    model.gravity.linear = pinocchio.rpy.rpyToMatrix(*base_rpy_rad).T @ np.array([0, 0, -9.81])
    return pinocchio.computeGeneralizedGravity(model, model.createData(), position)


@pytest.mark.parametrize("base_rpy_rad", MOUNTS)
@pytest.mark.parametrize("name", ARMS)
def test_model_of_a_mounted_arm_has_the_turned_gravity(name, base_rpy_rad):
    robot = shipped_arm(name)
    mounted = ManipulatorModel(replace(robot, base_rpy_rad=base_rpy_rad))
    position, rest = np.resize([0.3, -0.9, 1.2], robot.joints), np.zeros(robot.joints)
    expected = turned_gravity(robot, base_rpy_rad, position)
    np.testing.assert_allclose(mounted.gravity(position), expected, atol=1e-9)
    mass, load = np.empty((robot.joints, robot.joints)), np.empty(robot.joints)
    mass_and_load(mounted.rigid_bodies(), mounted.inertia_table(), position, rest, mass, load)
    np.testing.assert_allclose(load, expected, atol=1e-9)
    np.testing.assert_allclose(mass, ManipulatorModel(robot).mass_matrix(position), atol=1e-9)


@pytest.mark.parametrize("base_rpy_rad", MOUNTS)
@pytest.mark.parametrize("engine", INSTALLED)
def test_mounted_arm_falls_on_every_engine_as_its_model_does(engine, base_rpy_rad):
    robot = replace(PAPER_ARM, base_rpy_rad=base_rpy_rad)
    position, none = np.array([0.3, -0.9, 1.2]), np.zeros(3)
    with closing(FreeArm(robot, engine, 1e-4)) as arm:
        found = arm.acceleration(position, none)
    expected = forward_dynamics(ManipulatorModel(robot), position, none, none)
    upright = forward_dynamics(ManipulatorModel(PAPER_ARM), position, none, none)
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-2)
    assert np.abs(expected - upright).max() > 1.0


def test_mount_is_drawn():
    """The base hangs on the world by a link with the mounted orientation."""
    view = LinkPoses(replace(PAPER_ARM, base_rpy_rad=(np.pi / 2, 0.0, 0.0)))
    (mount,) = (at for at, link in enumerate(view.fixed) if link.parent == "funnel_hil_mount")
    np.testing.assert_allclose(view.fixed_poses[mount, 3:], [np.sqrt(0.5), 0, 0, np.sqrt(0.5)])


def test_no_mount_changes_nothing():
    assert load_setup("paper_arm").robot.resolved_urdf() == PAPER_ARM.resolved_urdf()


def test_degrees_are_refused():
    with pytest.raises(ScenarioError, match=r"robot\.base_rpy_rad\.0 = 90.*at most|less than"):
        load_setup("paper_arm", ["robot.base_rpy_rad=[90,0,0]"])


def test_arm_that_is_full_of_links_cannot_be_mounted(tmp_path):
    text = PAPER_ARM.path.read_text()
    count = text.count("<link ")
    more = "".join(
        f'<link name="x{i}"/><joint name="x{i}j" type="fixed"><parent link="x{i - 1}"/>'
        f'<child link="x{i}"/></joint>'
        for i in range(1, 127 - count)
    )
    first = f'<link name="x0"/><joint name="x0j" type="fixed"><parent link="{PAPER_ARM.tip_link}"/>'
    path = tmp_path / "long.urdf"
    path.write_text(text.replace("</robot>", f'{first}<child link="x0"/></joint>{more}</robot>'))
    robot = replace(load_robot(path), base_rpy_rad=(1.0, 0.0, 0.0))
    with pytest.raises(RobotDescriptionError, match="has 127 links; a mounted arm"):
        robot.resolved_urdf()

"""Joints that slide, and joints that follow others: every engine against pinocchio."""

from contextlib import closing

import numpy as np
import pytest

from bus_schema.robot_description import load_robot
from controller.manipulator_model import ManipulatorModel
from controller.rigid_bodies.dynamics import inverse_dynamics, mass_and_load
from tests.arms import INSTALLED, FreeArm, forward_dynamics

STEP_S = 1e-4
ROD = """
    <inertial>
      <origin xyz="0.15 0.02 0" rpy="0.1 0.2 0.3"/><mass value="{mass}"/>
      <inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0.001" ixz="0.002" iyz="0.003"/>
    </inertial>"""


def joint(name, kind, parent, child, axis, extra=""):
    limits = '<limit lower="-2" upper="2" effort="500" velocity="20"/>'
    return f"""
  <joint name="{name}" type="{kind}">
    <parent link="{parent}"/><child link="{child}"/>
    <origin xyz="0.3 0.1 0.05" rpy="0.2 0.1 0"/><axis xyz="{axis}"/>{limits}{extra}
  </joint>"""


def write(tmp_path, *joints):
    links = "".join(
        f'<link name="{name}">{ROD.format(mass=mass)}</link>'
        for name, mass in zip("bcde"[: len(joints)], (3, 2, 1.5, 1), strict=False)
    )
    path = tmp_path / "arm.urdf"
    path.write_text(f'<robot name="test"><link name="a"/>{links}{"".join(joints)}</robot>')
    return path


@pytest.fixture
def sliding(tmp_path):
    """Turns, slides, turns."""
    return load_robot(
        write(
            tmp_path,
            joint("swing", "revolute", "a", "b", "0 1 0"),
            joint("reach", "prismatic", "b", "c", "1 0 2"),
            joint("wrist", "continuous", "c", "d", "0 0 1"),
        )
    )


def mimic(leader, multiplier, offset):
    return f'<mimic joint="{leader}" multiplier="{multiplier}" offset="{offset}"/>'


@pytest.fixture
def following(tmp_path):
    """An elbow that follows the shoulder in series, and a slide beside that follows the elbow."""
    return load_robot(
        write(
            tmp_path,
            joint("shoulder", "revolute", "a", "b", "0 1 0"),
            joint("elbow", "revolute", "b", "c", "0 1 0", mimic("shoulder", -0.5, 0.1)),
            joint("wrist", "revolute", "c", "d", "0 0 1"),
            joint("slide", "prismatic", "b", "e", "0 0 1", mimic("elbow", 2, 0.05)),
        )
    )


@pytest.mark.parametrize("engine", INSTALLED)
@pytest.mark.parametrize("name", ["sliding", "following"])
def test_engine_accelerates_as_the_model_does(name, engine, request):
    robot = request.getfixturevalue(name)
    model, random = ManipulatorModel(robot), np.random.default_rng(3)
    with closing(FreeArm(robot, engine, STEP_S)) as arm:
        for _ in range(10):
            position = random.uniform(-0.4, 0.4, robot.joints)
            torque = random.uniform(-40, 40, robot.joints)
            expected = forward_dynamics(model, position, np.zeros(robot.joints), torque)
            found = arm.acceleration(position, torque)
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-3 * np.abs(expected).max())


@pytest.mark.parametrize("engine", INSTALLED)
def test_a_follower_stays_with_its_leader_and_energy_is_kept(engine, following):
    model = ManipulatorModel(following)
    with closing(FreeArm(following, engine, STEP_S)) as arm:
        arm.place(np.array([0.3, 0.2]))
        before = model.energy(arm.position, arm.velocity)
        scale = abs(model.gravity(arm.position)).max()
        arm.push(np.zeros(2), substeps=2000)
        assert np.abs(arm.velocity).max() > 0.5
        # The swing turns over tens of joules; a follower left behind would not be in the sum.
        assert model.energy(arm.position, arm.velocity) == pytest.approx(before, abs=0.01 * scale)


@pytest.mark.parametrize("name", ["sliding", "following"])
def test_compiled_terms_are_those_of_pinocchio(name, request):
    robot, random = request.getfixturevalue(name), np.random.default_rng(5)
    joints = robot.joints
    rotors = np.linspace(0.1, 0.3, joints)
    model = ManipulatorModel(robot, payload_kg=1.0, rotor_inertia_kg_m2=rotors)
    bodies, table = model.rigid_bodies(), model.inertia_table()
    mass, load, torque = np.empty((joints, joints)), np.empty(joints), np.empty(joints)
    for _ in range(10):
        q, v, a = random.uniform(-1.5, 1.5, (3, joints))
        mass_and_load(bodies, table, q, v, mass, load)
        inverse_dynamics(bodies, table, q, v, a, torque)
        np.testing.assert_allclose(mass, model.mass_matrix(q), atol=1e-11)
        np.testing.assert_allclose(torque, model.inverse_dynamics(q, v, a), atol=1e-10)


def test_reduced_terms_fit_together(following):
    model, random = ManipulatorModel(following), np.random.default_rng(6)
    for _ in range(5):
        q, v, a = random.uniform(-1, 1, (3, 2))
        terms = model.mass_matrix(q) @ a + model.inverse_dynamics(q, v, np.zeros(2))
        np.testing.assert_allclose(model.inverse_dynamics(q, v, a), terms, atol=1e-10)
        np.testing.assert_allclose(model.torque_along(q, v, v, a), terms, atol=1e-10)
        np.testing.assert_allclose(model.inverse_dynamics(q, 0 * q, 0 * q), model.gravity(q))

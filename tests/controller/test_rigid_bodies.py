"""Compiled rigid-body dynamics against pinocchio's."""

import numpy as np
import pytest

from bus_schema.robot_description import load_robot
from controller.manipulator_model import ManipulatorModel
from controller.rigid_bodies.dynamics import inverse_dynamics, mass_and_load
from controller.rigid_bodies.vectors import invert
from tests.arms import PAPER_ARM, listed_from_the_tip

SAMPLES = 20


def states(robot):
    """Random positions in range, velocities and accelerations."""
    random = np.random.default_rng(7)
    for _ in range(SAMPLES):
        yield (
            random.uniform(robot.lower_rad, robot.upper_rad),
            random.uniform(-2, 2, robot.joints),
            random.uniform(-30, 30, robot.joints),
        )


def compiled_terms(bodies, table, position, velocity):
    joints = position.size
    mass, load = np.empty((joints, joints)), np.empty(joints)
    mass_and_load(bodies, table, position, velocity, mass, load)
    return mass, load


def compiled_torque(bodies, table, position, velocity, acceleration):
    torque = np.empty(position.size)
    inverse_dynamics(bodies, table, position, velocity, acceleration, torque)
    return torque


def assert_equal_to_rounding(value, expected):
    """To 1e-9 of the largest entry: what cancels keeps the rounding of what it is made of."""
    np.testing.assert_allclose(value, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize(("scale", "payload_kg"), [(1.0, 0.0), (0.7, 0.0), (1.0, 2.0), (1.3, 3.0)])
def test_every_term_is_that_of_pinocchio(robot, scale, payload_kg):
    model = ManipulatorModel(robot, scale=scale, payload_kg=payload_kg)
    bodies, table = model.rigid_bodies(), model.inertia_table()
    rest = np.zeros(robot.joints)
    for position, velocity, acceleration in states(robot):
        mass, load = compiled_terms(bodies, table, position, velocity)
        assert_equal_to_rounding(mass, model.mass_matrix(position))
        np.testing.assert_array_equal(mass, mass.T)
        assert_equal_to_rounding(load, model.inverse_dynamics(position, velocity, rest))
        torque = compiled_torque(bodies, table, position, velocity, acceleration)
        assert_equal_to_rounding(torque, model.inverse_dynamics(position, velocity, acceleration))
        assert_equal_to_rounding(torque, mass @ acceleration + load)
        assert_equal_to_rounding(
            compiled_torque(bodies, table, position, rest, rest), model.gravity(position)
        )


def test_inverse_of_the_mass_matrix_is_that_of_pinocchio(robot):
    model = ManipulatorModel(robot)
    bodies, table = model.rigid_bodies(), model.inertia_table()
    for position, velocity, _ in states(robot):
        mass, _ = compiled_terms(bodies, table, position, velocity)
        before, inverse = mass.copy(), np.empty_like(mass)
        invert(mass, inverse)
        np.testing.assert_array_equal(mass, before)
        assert_equal_to_rounding(inverse, np.linalg.inv(model.mass_matrix(position)))
        np.testing.assert_allclose(inverse @ mass, np.eye(robot.joints), atol=1e-9)


def test_joints_listed_from_the_tip_are_worked_through_from_the_base(tmp_path):
    path = listed_from_the_tip(PAPER_ARM.path, tmp_path)
    forward, backward = PAPER_ARM, load_robot(path)
    assert backward.joint_names == forward.joint_names[::-1]
    model, reversed_model = ManipulatorModel(forward), ManipulatorModel(backward)
    bodies, table = reversed_model.rigid_bodies(), reversed_model.inertia_table()
    assert bodies.outwards.tolist() == [2, 1, 0]
    assert bodies.parents.tolist() == [1, 2, -1]
    for position, velocity, acceleration in states(forward):
        motion = (position[::-1].copy(), velocity[::-1].copy())
        mass, load = compiled_terms(bodies, table, *motion)
        assert_equal_to_rounding(mass[::-1, ::-1], model.mass_matrix(position))
        bare = model.inverse_dynamics(position, velocity, np.zeros(3))
        assert_equal_to_rounding(load[::-1], bare)
        torque = compiled_torque(bodies, table, *motion, acceleration[::-1].copy())
        expected = model.inverse_dynamics(position, velocity, acceleration)
        assert_equal_to_rounding(torque[::-1], expected)


def test_rotors_are_the_same_in_both():
    rotors = np.array([3.0, 5.0, 1.0])
    model = ManipulatorModel(PAPER_ARM, scale=0.8, rotor_inertia_kg_m2=rotors)
    bare = ManipulatorModel(PAPER_ARM, scale=0.8)
    bodies, table = model.rigid_bodies(), model.inertia_table()
    for position, velocity, acceleration in states(PAPER_ARM):
        mass, load = compiled_terms(bodies, table, position, velocity)
        np.testing.assert_allclose(mass - bare.mass_matrix(position), np.diag(rotors), atol=1e-9)
        zero = np.zeros(3)
        assert_equal_to_rounding(load, bare.inverse_dynamics(position, velocity, zero))
        torque = compiled_torque(bodies, table, position, velocity, acceleration)
        expected = model.inverse_dynamics(position, velocity, acceleration)
        assert_equal_to_rounding(torque, expected)
        own = bare.inverse_dynamics(position, velocity, acceleration)
        np.testing.assert_allclose(torque - own, rotors * acceleration, atol=1e-9)

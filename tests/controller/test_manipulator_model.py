from pathlib import Path

import numpy as np
import pytest

from bus_schema.robot_description import load_robot
from controller.manipulator_model import ManipulatorModel
from deploy.scenario.referenced_files import find_urdf
from tests.arms import ARMS, listed_from_the_tip

SAMPLES = 20


@pytest.fixture(params=ARMS)
def robot(request):
    return load_robot(find_urdf(request.param, Path()))


def states(robot):
    """Random positions in range with velocities of either sign, rad/s."""
    random = np.random.default_rng(3)
    for _ in range(SAMPLES):
        yield random.uniform(robot.lower_rad, robot.upper_rad), random.uniform(-2, 2, robot.joints)


def test_mass_matrix_is_symmetric_and_positive_definite(robot):
    model = ManipulatorModel(robot)
    for position, _ in states(robot):
        inertia = model.mass_matrix(position)
        assert inertia.shape == (robot.joints, robot.joints)
        assert (inertia == inertia.T).all()
        assert np.linalg.eigvalsh(inertia).min() > 1e-4


def test_mass_matrix_rate_minus_twice_coriolis_is_skew_symmetric(robot):
    model, step = ManipulatorModel(robot), 1e-5
    for position, velocity in states(robot):
        ahead = model.mass_matrix(position + step * velocity)
        behind = model.mass_matrix(position - step * velocity)
        skew = (ahead - behind) / (2 * step) - 2 * model.coriolis_matrix(position, velocity)
        # Central difference, step 1e-5, M of order 10: 1e-8 from third derivative and rounding.
        np.testing.assert_allclose(skew, -skew.T, atol=1e-6)
        assert np.abs(skew).max() > 1e-3


def test_equation_of_motion_is_the_sum_of_its_terms(robot):
    model = ManipulatorModel(robot)
    for position, velocity in states(robot):
        acceleration = np.sin(1.0 + np.arange(robot.joints))
        terms = (
            model.mass_matrix(position) @ acceleration
            + model.coriolis_matrix(position, velocity) @ velocity
            + model.gravity(position)
        )
        torque = model.inverse_dynamics(position, velocity, acceleration)
        np.testing.assert_allclose(terms, torque, atol=1e-10)


def test_forward_dynamics_undoes_inverse_dynamics(robot):
    model = ManipulatorModel(robot)
    for position, velocity in states(robot):
        acceleration = 5.0 * np.cos(np.arange(robot.joints))
        torque = model.inverse_dynamics(position, velocity, acceleration)
        # Rounding times the condition of M, below 1e4.
        np.testing.assert_allclose(
            model.forward_dynamics(position, velocity, torque), acceleration, atol=1e-9
        )


def test_power_of_the_torques_is_the_rate_of_energy(robot):
    model, step = ManipulatorModel(robot), 1e-5
    for position, velocity in states(robot):
        torque = 10.0 * np.sin(np.arange(robot.joints) + 0.5)
        acceleration = model.forward_dynamics(position, velocity, torque)
        ahead = model.energy(position + step * velocity, velocity + step * acceleration)
        behind = model.energy(position - step * velocity, velocity - step * acceleration)
        # The acceleration of a light wrist is near 1e4 rad/s², hence the relative part.
        power = torque @ velocity
        expected = pytest.approx((ahead - behind) / (2 * step), rel=1e-4, abs=1e-4)
        assert power == expected


def test_gravity_is_the_slope_of_the_potential_energy(robot):
    model, step, rest = ManipulatorModel(robot), 1e-5, np.zeros(robot.joints)
    for position, _ in states(robot):
        slope = [
            (model.energy(position + d, rest) - model.energy(position - d, rest)) / (2 * step)
            for d in step * np.eye(robot.joints)
        ]
        np.testing.assert_allclose(model.gravity(position), slope, atol=1e-6)


@pytest.mark.parametrize("scale", [0.5, 0.9, 1.3])
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
    original = find_urdf("paper_arm", Path())
    path = listed_from_the_tip(original, tmp_path)
    forward, backward = ManipulatorModel(load_robot(original)), ManipulatorModel(load_robot(path))
    assert load_robot(path).joint_names == ("elbow", "shoulder", "base_yaw")
    for position, velocity in states(load_robot(original)):
        inertia = forward.mass_matrix(position)[::-1, ::-1]
        np.testing.assert_allclose(backward.mass_matrix(position[::-1]), inertia, atol=1e-12)
        torque = forward.inverse_dynamics(position, velocity, velocity)[::-1]
        reverse = backward.inverse_dynamics(position[::-1], velocity[::-1], velocity[::-1])
        np.testing.assert_allclose(reverse, torque, atol=1e-12)
        acceleration = forward.forward_dynamics(position, velocity, velocity)[::-1]
        reverse = backward.forward_dynamics(position[::-1], velocity[::-1], velocity[::-1])
        np.testing.assert_allclose(reverse, acceleration, atol=1e-10)
        torque = forward.torque_along(position, velocity, 2.0 * position, velocity)[::-1]
        reverse = backward.torque_along(
            position[::-1], velocity[::-1], 2.0 * position[::-1], velocity[::-1]
        )
        np.testing.assert_allclose(reverse, torque, atol=1e-12)
        np.testing.assert_allclose(
            backward.tip_position(position[::-1]), forward.tip_position(position), atol=1e-12
        )

"""Every physics engine against an independent integration of pinocchio's dynamics."""

from pathlib import Path

import numpy as np
import pytest

from bus_schema.configuration import ConfigurationError
from bus_schema.robot_description import load_robot
from controller.manipulator_model import ManipulatorModel
from deploy.scenario.referenced_files import find_urdf
from plant_emulator.configuration import PlantConfiguration
from plant_emulator.physics.engines import ENGINES, engine_in_force
from tests.arms import INSTALLED, FreeArm, listed_from_the_tip

pytestmark = pytest.mark.parametrize("engine", INSTALLED)

ROBOT = load_robot(find_urdf("paper_arm", Path()))
START = np.array([0.3, -0.9, 1.2])
DURATION_S = 0.6
LARGEST_ERROR_RAD = 5e-3  # at a substep of 0.25 ms, after 0.6 s of motion through 3 rad


def shaking(time_s):
    """Torques of up to 400 N m that throw the arm about at several rad/s, N m."""
    return np.array([250.0, 400.0, 100.0]) * np.sin(
        np.array([9.0, 9.0, 13.0]) * time_s + np.array([0.5, 3.5, 5.0])
    )


def free(_time_s):
    return np.zeros(3)


def emulated(engine, step_s, torque, **specification):
    """States (positions, velocities) of the emulated arm after each millisecond."""
    arm = FreeArm(ROBOT, engine, step_s, **specification)
    arm.place(START)
    every, rows = round(1e-3 / step_s), []
    for step in range(round(DURATION_S / step_s)):
        arm.push(torque(step * step_s))
        if (step + 1) % every == 0:
            rows.append(np.concatenate([arm.position, arm.velocity]))
    arm.close()
    return np.array(rows)


def integrated(torque):
    """Positions after each millisecond by RK4 on forward dynamics; its own error is below 1e-8."""
    model, step = ManipulatorModel(ROBOT), 1e-3
    state, rows = np.concatenate([START, np.zeros(3)]), []

    def rate(time_s, state):
        position, velocity = state[:3], state[3:]
        return np.concatenate(
            [velocity, model.forward_dynamics(position, velocity, torque(time_s))]
        )

    for index in range(round(DURATION_S / step)):
        time_s = index * step
        k_1 = rate(time_s, state)
        k_2 = rate(time_s + 0.5 * step, state + 0.5 * step * k_1)
        k_3 = rate(time_s + 0.5 * step, state + 0.5 * step * k_2)
        k_4 = rate(time_s + step, state + step * k_3)
        state = state + step / 6.0 * (k_1 + 2.0 * k_2 + 2.0 * k_3 + k_4)
        rows.append(state[:3])
    return np.array(rows)


@pytest.mark.parametrize("torque", [shaking, free])
def test_error_of_the_emulated_motion_is_of_first_order_in_the_substep(engine, torque):
    exact = integrated(torque)
    errors = [
        np.abs(emulated(engine, step, torque)[:, :3] - exact).max() for step in (1e-3, 5e-4, 2.5e-4)
    ]
    assert np.ptp(exact, axis=0).max() > 2.0
    # A semi-implicit Euler step halves its error with its length: 4 at a quarter, 2 at a half.
    assert 3.0 < errors[0] / errors[2] < 5.0
    assert 1.6 < errors[0] / errors[1] < 2.5
    assert errors[2] < LARGEST_ERROR_RAD


def test_energy_of_the_free_arm_is_conserved_to_first_order_in_the_substep(engine):
    model = ManipulatorModel(ROBOT)
    start_j = model.energy(START, np.zeros(3))
    drifts = []
    for step_s in (1e-3, 2.5e-4):
        states = emulated(engine, step_s, free)
        energies = [model.energy(state[:3], state[3:]) for state in states]
        drifts.append(np.abs(np.array(energies) - start_j).max())
        kinetic_j = energies[-1] - model.energy(states[-1, :3], np.zeros(3))
        assert kinetic_j > 50.0  # what falls is turned into motion, not lost
    assert 3.0 < drifts[0] / drifts[1] < 5.0
    assert drifts[1] < 1.0


def test_runge_kutta_keeps_energy_to_rounding_where_the_engine_has_it(engine):
    if "runge_kutta_4" not in ENGINES[engine].integrators:
        with pytest.raises(ConfigurationError, match=r"integrator = 'runge_kutta_4': must be semi"):
            engine_in_force(
                PlantConfiguration.model_validate(
                    {"physics": {"engine": engine, "integrator": "runge_kutta_4"}}
                )
            )
        return
    model = ManipulatorModel(ROBOT)
    (*_, last) = emulated(engine, 2.5e-4, free, integrator="runge_kutta_4")
    drift_j = model.energy(last[:3], last[3:]) - model.energy(START, np.zeros(3))
    assert abs(drift_j) < 1e-7  # of more than 50 J that were turned into motion


def test_place_puts_the_arm_at_rest(engine):
    arm = FreeArm(ROBOT, engine)
    arm.place(START)
    np.testing.assert_array_equal(arm.position, START)
    np.testing.assert_array_equal(arm.velocity, np.zeros(3))
    arm.push(np.zeros(3), substeps=50)
    assert np.abs(arm.velocity).max() > 0.1
    arm.place(START)
    np.testing.assert_array_equal(arm.position, START)
    np.testing.assert_array_equal(arm.velocity, np.zeros(3))
    arm.close()


def test_arms_do_not_share_a_world(engine):
    one, other = FreeArm(ROBOT, engine), FreeArm(ROBOT, engine, 2.5e-4)
    one.place(START)
    other.place(-START)
    one.push(np.zeros(3))
    np.testing.assert_array_equal(other.position, -START)
    one.close()
    other.push(np.zeros(3))
    assert (other.velocity != 0.0).any()
    other.close()


def test_torque_of_one_substep_does_not_linger(engine):
    pushed, left = (FreeArm(ROBOT, engine) for _ in range(2))
    gravity = ManipulatorModel(ROBOT).gravity(START)
    for arm in (pushed, left):
        arm.place(START)
    pushed.push(gravity + np.array([100.0, 0.0, 0.0]))
    speed = pushed.velocity[0]
    pushed.push(ManipulatorModel(ROBOT).gravity(pushed.position))
    # Held against gravity, the yaw coasts; a torque that stayed would double its speed.
    assert pushed.velocity[0] == pytest.approx(speed, rel=0.01)
    left.push(gravity)
    assert np.abs(left.velocity).max() < 1e-9
    pushed.close()
    left.close()


def test_joints_keep_the_order_of_the_file(engine, tmp_path):
    """Engines number joints from the base; a file may list them from the tip."""
    path = listed_from_the_tip(ROBOT.path, tmp_path)
    forward, backward = FreeArm(ROBOT, engine), FreeArm(load_robot(path), engine)
    forward.place(START)
    backward.place(START[::-1])
    for step in range(20):
        forward.push(shaking(1e-3 * step))
        backward.push(shaking(1e-3 * step)[::-1])
    np.testing.assert_array_equal(backward.position[::-1], forward.position)
    np.testing.assert_allclose(
        backward.mass_matrix(START[::-1]), forward.mass_matrix(START)[::-1, ::-1], atol=1e-10
    )
    forward.close()
    backward.close()

"""Every physics engine against an independent integration of pinocchio's dynamics."""

import numpy as np
import pytest

from bus_schema.configuration import ConfigurationError
from bus_schema.robot_description import load_robot
from controller.manipulator_model import ManipulatorModel
from plant_emulator.configuration import PlantConfiguration
from plant_emulator.physics.engines import ENGINES, engine_in_force
from tests.arms import (
    INSTALLED,
    PAPER_ARM,
    FreeArm,
    forward_dynamics,
    listed_from_the_tip,
    runge_kutta,
)

pytestmark = pytest.mark.parametrize("engine", INSTALLED)

ROBOT = PAPER_ARM
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
    model, steps = ManipulatorModel(ROBOT), round(DURATION_S / 1e-3)

    def rate(time_s, state):
        position, velocity = state[:3], state[3:]
        acceleration = forward_dynamics(model, position, velocity, torque(time_s))
        return np.concatenate([velocity, acceleration])

    start = np.concatenate([START, np.zeros(3)])
    return np.array(list(runge_kutta(rate, start, 1e-3, steps + 1)))[1:, :3]


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

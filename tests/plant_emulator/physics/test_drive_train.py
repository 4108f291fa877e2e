"""Motors and gears: reflected inertia, elastic gears, speed, cogging, and where encoders sit."""

import math
from contextlib import closing

import numpy as np
import pytest

from bus_schema.configuration import ConfigurationError
from bus_schema.robot_description import load_robot
from controller.manipulator_model import ManipulatorModel
from plant_emulator.arm.drive_train import drive_trains, largest_torque
from plant_emulator.configuration import ActuatorConfiguration, PlantConfiguration
from plant_emulator.physics.engines import engine_in_force, engine_name
from tests.arms import PAPER_ARM, FreeArm, forward_dynamics
from tests.one_joint import write_arm

ROTORS = np.array([3.0, 5.0, 1.0])
POSTURE = np.array([0.3, -0.9, 1.2])
STEP_S = 1e-4


def plant_of(**actuator):
    return PlantConfiguration.model_validate({"actuator": actuator})


def arm_with(**actuator):
    plant = plant_of(**actuator)
    own = plant.actuator.rigid_rotor_inertia(3)
    return closing(FreeArm(PAPER_ARM, "mujoco", STEP_S, plant, rotor_inertia_kg_m2=own))


def test_a_rotor_adds_its_inertia_to_its_joint():
    torque = np.array([40.0, -60.0, 30.0])
    with arm_with(rotor_inertia_kg_m2=ROTORS.tolist()) as free:
        free.place(POSTURE)
        free.push(torque)
        moved = free.velocity / STEP_S
    model = ManipulatorModel(PAPER_ARM, rotor_inertia_kg_m2=ROTORS)
    np.testing.assert_allclose(
        moved, forward_dynamics(model, POSTURE, np.zeros(3), torque), rtol=1e-6
    )


def test_a_rotor_adds_its_inertia_to_the_only_joint(tmp_path):
    """MuJoCo keeps the inertia of an axis through the link's centre of mass as a constant."""
    robot = load_robot(write_arm(tmp_path, 1.0))
    arm = FreeArm(robot, "mujoco", STEP_S, rotor_inertia_kg_m2=np.array([0.5]))
    with closing(arm) as free:
        assert free.mass_matrix(np.zeros(1)) == pytest.approx(1.5)
        free.arm.set_brakes(engaged=True)
        free.arm.set_brakes(engaged=False)
        assert free.mass_matrix(np.zeros(1)) == pytest.approx(1.5)


def test_a_brake_leaves_the_rotors_as_they_were():
    with arm_with(rotor_inertia_kg_m2=ROTORS.tolist()) as free:
        free.place(POSTURE)
        free.arm.set_brakes(engaged=True)
        free.arm.set_brakes(engaged=False)
        free.push(np.array([50.0, 0.0, 0.0]))
        moved = free.velocity[0]
    with arm_with(rotor_inertia_kg_m2=ROTORS.tolist()) as fresh:
        fresh.place(POSTURE)
        fresh.push(np.array([50.0, 0.0, 0.0]))
        assert fresh.velocity[0] == moved


def test_rotor_and_link_swing_at_the_frequency_of_two_masses_on_a_spring():
    # The base of the arm turns about a vertical axis, so gravity plays no part; the others are
    # held, so the link is one inertia. ω² = k (1 / J + 1 / M) for k = 4,000 N m/rad.
    stiffness = 4000.0
    with arm_with(rotor_inertia_kg_m2=ROTORS.tolist(), gear_stiffness_nm_rad=stiffness) as free:
        free.place(POSTURE)
        free.arm.hold([False, True, True])
        rotors = free.arm._torques.tables.trains.rotors
        rotors[0, 0] += 0.01
        twists = []
        for _ in range(4000):
            free.push(np.zeros(3))
            twists.append(rotors[0, 0] - free.position[0])
    link = ManipulatorModel(PAPER_ARM).mass_matrix(POSTURE)[0, 0]
    expected_rad_s = math.sqrt(stiffness * (1.0 / ROTORS[0] + 1.0 / link))
    falls = np.flatnonzero((np.array(twists[:-1]) > 0) & (np.array(twists[1:]) <= 0))
    period_s = STEP_S * np.diff(falls).mean()
    assert 2.0 * math.pi / period_s == pytest.approx(expected_rad_s, rel=0.005)
    assert max(twists) == pytest.approx(0.01, rel=0.02)  # nothing damps it


def test_an_elastic_gear_carries_the_arm_from_the_start():
    with arm_with(rotor_inertia_kg_m2=ROTORS.tolist(), gear_stiffness_nm_rad=2e4) as free:
        free.place(POSTURE)
        gravity = ManipulatorModel(PAPER_ARM).gravity(POSTURE)
        free.push(gravity, 200)  # the motors hold it: nothing moves
        np.testing.assert_allclose(free.position, POSTURE, atol=1e-6)
        twist = free.arm._torques.tables.trains.rotors[0] - free.position
        np.testing.assert_allclose(twist, gravity / 2e4, atol=1e-6)


@pytest.mark.parametrize(
    ("speed", "torque", "expected"),
    [
        (0.0, 1.0, 400.0), (2.0, 1.0, 400.0), (3.0, 1.0, 200.0), (4.0, 1.0, 0.0), (9.0, 1.0, 0.0),
        (3.0, -1.0, 400.0), (-3.0, 1.0, 400.0),  # it may brake with all it has
    ],
)  # fmt: skip
def test_torque_falls_with_speed_beyond_half_the_no_load_speed(speed, torque, expected):
    trains = drive_trains(ActuatorConfiguration(no_load_speed_rad_s=4.0), PAPER_ARM, STEP_S)
    assert largest_torque(trains, 0, torque, speed) == expected


def test_cogging_follows_the_angle():
    with arm_with(rotor_inertia_kg_m2=ROTORS.tolist(), cogging_nm=2.0, cogging_periods=50) as free:
        free.place(np.array([math.pi / 100.0, 0.0, 0.0]))  # a quarter of a period: its largest
        before = free.velocity[0]
        free.push(np.zeros(3))
        inertia = ManipulatorModel(PAPER_ARM, rotor_inertia_kg_m2=ROTORS)
        torque = np.array([-2.0, 0.0, 0.0])
        expected = forward_dynamics(inertia, np.array([math.pi / 100, 0, 0]), np.zeros(3), torque)
        assert (free.velocity[0] - before) / STEP_S == pytest.approx(expected[0], rel=1e-6)


def test_a_current_loop_is_a_lag():
    trains = drive_trains(ActuatorConfiguration(current_loop_hz=100.0), PAPER_ARM, STEP_S)
    assert trains.lag_factor == pytest.approx(math.exp(-STEP_S * 2.0 * math.pi * 100.0))


def test_motors_are_mujocos():
    with_rotors = {"actuator": {"rotor_inertia_kg_m2": 1.0}}
    assert engine_name(PlantConfiguration.model_validate(with_rotors)) == "mujoco"
    on_bullet = PlantConfiguration.model_validate(with_rotors | {"physics": {"engine": "bullet"}})
    with pytest.raises(ConfigurationError, match=r"plant\.physics\.engine = 'bullet'"):
        engine_in_force(on_bullet)

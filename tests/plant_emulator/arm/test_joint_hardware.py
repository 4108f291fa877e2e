import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plant_emulator.arm.joint_hardware import Encoders
from plant_emulator.arm.joint_torques import TOTAL, joint_torques
from plant_emulator.configuration import (
    ActuatorConfiguration,
    EncoderConfiguration,
    PlantConfiguration,
)
from tests.arms import PAPER_ARM, torques_of

ROBOT = PAPER_ARM
SUBSTEP_S = 2.5e-4


def encoders_of(position, velocity, seed=0, **values):
    motion = np.array([position, velocity], dtype=float)
    return Encoders(EncoderConfiguration(**values), motion, np.random.default_rng(seed))


def read(encoders):
    encoders.read()
    return encoders.shown


def actuators_of(**values):
    return torques_of(PlantConfiguration(actuator=ActuatorConfiguration(**values)))


def acted(torques, commanded, velocity=(0.0, 0.0, 0.0)):
    """Total torque of a substep, and whether actuators saturate."""
    motion = np.array([np.zeros(3), velocity])
    torques.asked[:] = commanded
    saturated, _ = joint_torques(motion, 0.0, torques.tables)
    return torques.tables.torques_nm[TOTAL].tolist(), saturated


@given(
    st.tuples(*[st.floats(-3.0, 3.0)] * 3),
    st.tuples(*[st.floats(-9.0, 9.0)] * 3),
)
def test_ideal_encoders_show_the_truth(position, velocity):
    seen_position, seen_velocity = read(encoders_of(position, velocity))
    assert seen_position.tolist() == list(position)
    assert seen_velocity.tolist() == list(velocity)


@given(st.tuples(*[st.floats(-3.0, 3.0)] * 3))
def test_positions_are_the_nearest_multiple_of_the_resolution(position):
    resolution = np.array([1e-3, 0.0, 2.0 * np.pi / 4096])
    seen, _ = read(encoders_of(position, np.zeros(3), resolution_rad=resolution))
    assert seen[1] == position[1]
    for joint in (0, 2):
        assert abs(seen[joint] - position[joint]) <= 0.5 * resolution[joint] * (1.0 + 1e-9)
        counts = seen[joint] / resolution[joint]
        assert counts == pytest.approx(round(counts), abs=1e-9)


def test_velocity_noise_is_white_gaussian_and_unbiased():
    deviation = np.array([0.1, 0.0, 0.02])
    encoders = encoders_of(np.ones(3), np.full(3, 5.0), velocity_noise_rad_s=deviation)
    count = 20_000
    noise = np.array([read(encoders)[1] - 5.0 for _ in range(count)])
    assert (noise[:, 1] == 0.0).all()
    for joint in (0, 2):
        share = noise[:, joint] / deviation[joint]
        # Five standard errors: of the mean 1/√n, of the deviation 1/√2n, of a correlation 1/√n.
        assert abs(share.mean()) < 5.0 / np.sqrt(count)
        assert abs(share.std() - 1.0) < 5.0 / np.sqrt(2 * count)
        assert abs(np.corrcoef(share[1:], share[:-1])[0, 1]) < 5.0 / np.sqrt(count)
        assert np.mean(np.abs(share) < 1.0) == pytest.approx(0.683, abs=0.017)
    assert abs(np.corrcoef(noise[:, 0], noise[:, 2])[0, 1]) < 5.0 / np.sqrt(count)


def test_saturation_defaults_to_the_limits_of_the_urdf():
    torques = actuators_of()
    assert acted(torques, [1e6, -1e6, 299.0]) == ([400.0, -700.0, 299.0], True)
    assert acted(torques, [399.0, -699.0, 299.0]) == ([399.0, -699.0, 299.0], False)


@pytest.mark.parametrize("lag_ms", [0.1, 2.0, 50.0])
def test_lag_is_the_exact_discretisation_of_a_first_order_filter(lag_ms):
    torques, command = actuators_of(lag_ms=lag_ms), np.array([100.0, -200.0, 50.0])
    for step in range(1, 200):
        acted(torques, command)
        expected = command * -np.expm1(-step * SUBSTEP_S / (1e-3 * lag_ms))
        # Only rounding: the exponential is exact at any ratio of substep to time constant.
        np.testing.assert_allclose(torques.actuator, expected, rtol=1e-12)


def test_lag_filters_what_is_left_after_saturation():
    torques = actuators_of(lag_ms=1.0)
    for _ in range(40):  # ten time constants
        acted(torques, np.full(3, 1e9))
    np.testing.assert_allclose(torques.actuator, ROBOT.effort_limits_nm, rtol=1e-4)
    assert (torques.actuator < ROBOT.effort_limits_nm).all()


def test_total_is_actuator_less_friction_less_disturbance():
    configuration = PlantConfiguration.model_validate(
        {
            "friction": {"viscous_nm_s": [1.0, 2.0, 3.0]},
            "disturbance": {"terms": [{"joint": "elbow", "kind": "constant", "torque_nm": 7.0}]},
        }
    )
    torques = torques_of(configuration)
    total, _ = acted(torques, [10.0, 20.0, 30.0], velocity=[1.0, -1.0, 2.0])
    assert torques.actuator.tolist() == [10.0, 20.0, 30.0]
    assert torques.friction.tolist() == [1.0, -2.0, 6.0]
    assert torques.disturbance.tolist() == [0.0, 0.0, 7.0]
    assert total == [9.0, 22.0, 17.0]
    torques.rest()
    assert not np.any([torques.actuator, torques.friction, torques.disturbance])

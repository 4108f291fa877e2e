"""``joint_trajectory``, ``egm``, ``rsi`` and ``servo``."""

import numpy as np
import pytest

from plant_emulator.interfaces.egm import EgmSettings
from plant_emulator.interfaces.franka_torque import FrankaTorqueSettings
from plant_emulator.interfaces.joint_trajectory import JointTrajectorySettings
from plant_emulator.interfaces.rsi import RsiSettings
from plant_emulator.interfaces.servo import ServoSettings
from plant_emulator.interfaces.settings import InterfaceSettings
from tests.plant_emulator.interfaces.driven import PERIOD_S as H
from tests.plant_emulator.interfaces.driven import driven, rows, started

SPEED = 0.5


def test_cubic_segments_reproduce_a_cubic():
    """A cubic is the only one with its positions and velocities at both ends."""
    curve = np.polynomial.Polynomial([0.0, 0.0, 3.0, -2.0])
    settings = JointTrajectorySettings(
        point_after_ms=500, lag_ms=0.0, interpolate_from_desired_state=True
    )
    found = driven(started(settings), [rows(curve(0.5), curve.deriv()(0.5)), *[None] * 498])
    times_s = H * np.arange(1, 500)  # the controller samples a cycle ahead
    np.testing.assert_allclose(found[:, 0], curve(times_s), atol=1e-12)
    np.testing.assert_allclose(found[:, 1], curve.deriv()(times_s), atol=1e-12)


@pytest.mark.parametrize("from_desired", [False, True])
@pytest.mark.parametrize("lag_ms", [5.0, 10.0])
def test_new_messages_pull_a_lagging_robot_back_by_its_lag(lag_ms, from_desired):
    """Teeth of v L, with a message every 33 ms; targets stay for a cycle, half of which is lag."""
    robot = started(JointTrajectorySettings(
        point_after_ms=500, lag_ms=lag_ms, interpolate_from_desired_state=from_desired
    ))  # fmt: skip
    planned, measured = [], np.zeros((2, 1))
    for k in range(33 * 40):
        target = rows(SPEED * (H * k + 0.5), SPEED) if k % 33 == 0 else None
        measured = np.stack(robot.step(target, measured)[:2])
        planned.append(robot.planned[:, 0])
    position, speed = np.array(planned).T
    last = 33 * np.arange(20, 40) - 1  # before a message
    teeth = position[last] + H * speed[last] - position[last + 1]
    expected = 0.0 * speed[last] if from_desired else speed[last] * (1e-3 * lag_ms + 0.5 * H)
    np.testing.assert_allclose(teeth, expected, rtol=0.05, atol=1e-6)
    assert (speed[last] > 0.9 * SPEED).all()


def test_egm_with_gain_0_is_pure_velocity():
    """A step to v through a first-order filter of 20 Hz: v (1 − e^(−2π 20 t))."""
    robot = started(EgmSettings(gain_per_s=0.0))
    found = driven(robot, [rows(123.0, SPEED)] * 200)
    expected = SPEED * (1.0 - np.exp(-2.0 * np.pi * 20.0 * H * np.arange(200)))
    np.testing.assert_allclose(found[:, 1], expected, atol=1e-12)


def test_egm_with_a_gain_goes_to_the_position():
    found = driven(started(EgmSettings()), [rows(0.3)] * 1500)
    assert found[-1, 0] == pytest.approx(0.3, abs=1e-6)


def test_egm_goes_on_until_its_time_out_which_is_a_fault():
    robot = started(EgmSettings(gain_per_s=0.0, timeout_ms=100.0))
    found = driven(robot, [*[rows(0, SPEED)] * 300, *[None] * 99])
    assert found[-1, 1] == pytest.approx(SPEED)
    assert robot.reflex is None
    robot.step(None, rows(0))
    assert robot.reflex.kind == "egm_communication_timeout"


@pytest.mark.parametrize(("hold_on", "after"), [(True, 0.2), (False, 0.0)])
def test_rsi_holds_or_drops_its_correction(hold_on, after):
    robot = started(RsiSettings(hold_on=hold_on, dead_time_ms=0.0, lag_ms=0.0))
    found = driven(robot, [rows(0.2), None, rows(0.2)])
    assert found[:, 0].tolist() == [0.2, after, 0.2]


def test_rsi_faults_after_100_late_packets():
    robot = started(RsiSettings())
    for late in range(100):
        assert robot.reflex is None, late
        robot.step(None, rows(0))
    assert robot.reflex.kind == "rsi_late_packets"


def test_servo_has_a_dead_band_and_a_resolution():
    robot = started(ServoSettings(dead_band_rad=0.01, resolution_rad=0.004))
    found = driven(robot, [rows(0.009), rows(0.0151), rows(0.0222), rows(0.03)])
    # Rounded to 8, 16, 24 and 32 mrad; a change of at most 10 mrad does not count.
    np.testing.assert_allclose(found[:, 0], [0.0, 0.016, 0.016, 0.032], atol=1e-12)


@pytest.mark.parametrize(
    ("settings", "first", "later"),
    [
        (FrankaTorqueSettings(), [np.zeros((1, 1)), np.full((1, 1), 9.0)], [None] * 25),
        (RsiSettings(most_late=2), [None, None], [None] * 5),
        (EgmSettings(), [None] * 200, [None] * 5),
    ],
)
def test_the_first_reflex_is_the_one_that_stays(settings, first, later):
    robot = started(settings)
    for target in first:
        robot.step(target, rows(0))
    reflex = robot.reflex
    assert reflex is not None
    for target in later:
        robot.step(target, rows(0))
    assert robot.reflex == reflex


def test_settings_of_a_robot_without_a_controller_are_refused():
    class Nothing(InterfaceSettings):
        """A kind that lacks `build`."""

    with pytest.raises(TypeError, match=r"abstract method '?build"):
        Nothing()

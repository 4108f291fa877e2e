"""Franka: lost targets, limits and their reflexes, limiter and filter."""

import numpy as np
import pytest

from plant_emulator.interfaces.franka import FrankaMotionSettings, FrankaVelocitySettings
from plant_emulator.interfaces.franka_torque import FrankaTorqueSettings
from tests.plant_emulator.interfaces.driven import PERIOD_S as H
from tests.plant_emulator.interfaces.driven import driven, rows, started

LOST = "communication_constraints_violation"
ACCELERATION = 5.0  # rad/s², reached with 1 rad/s² in each cycle: 1000 rad/s³


def accelerating(cycles):
    """Positions, by backward differences, of an acceleration that rises to 5 rad/s²."""
    acceleration = np.minimum(np.arange(1, cycles + 1), ACCELERATION)
    return np.cumsum(H * np.cumsum(H * acceleration))


@pytest.mark.parametrize("kind", ["position", "velocity", "torque"])
def test_19_lost_in_a_row_keep_the_robot_and_20_stop_it(kind):
    settings = {
        "position": FrankaMotionSettings(), "velocity": FrankaVelocitySettings(),
        "torque": FrankaTorqueSettings(),
    }[kind]  # fmt: skip
    target = np.zeros((1, 1)) if kind == "torque" else rows(0.0)
    robot = started(settings)
    for missing, stops in ((19, False), (1, False), (19, False), (20, True)):
        for _ in range(missing):
            assert robot.reflex is None
            robot.step(None, rows(0.0))
        assert (robot.reflex is not None) is stops
        if not stops:
            robot.step(target, rows(0.0))
    assert robot.reflex.kind == LOST
    assert robot.reflex.joint == -1


def test_a_lost_position_is_extrapolated_with_constant_acceleration():
    """Targets that go on at that acceleration leave no trace of what was lost."""
    positions = accelerating(60)
    targets = [None if 30 <= k < 49 else rows(q) for k, q in enumerate(positions)]
    robot = started(FrankaMotionSettings())
    np.testing.assert_allclose(driven(robot, targets)[:, 0], positions, atol=1e-12)
    assert robot.reflex is None


def test_a_return_to_the_plan_after_an_extrapolation_is_a_discontinuity():
    """The plan is at a constant speed from the loss on; the robot went on accelerating.

    After n cycles its speed is n h a too high, and its position n (n + 1)/2 h² a too far: one
    cycle to return needs an acceleration of −(n + (n + 1)(n + 2)/2 …) a, beyond 10 rad/s² for n=4.
    """
    positions = accelerating(30)
    speed = positions[-1] - positions[-2]
    plan = positions[-1] + speed * np.arange(1, 30)
    targets = [*map(rows, positions), *[None] * 4, rows(plan[4])]
    robot = started(FrankaMotionSettings())
    found = driven(robot, targets)
    # Backward differences of what was commanded, against the limit.
    line = np.array(
        [
            *positions,
            *(
                positions[-1]
                + speed * np.arange(1, 5)
                + ACCELERATION * H**2 * np.array([1, 3, 6, 10])
            ),
            plan[4],
        ]
    )
    acceleration = np.diff(line, 2)[-1] / H**2
    assert abs(acceleration) > 10.0
    assert robot.reflex.kind == "joint_motion_generator_velocity_discontinuity"
    assert f"{abs(acceleration):.3g}" in robot.reflex.words
    assert found[-1, 0] == pytest.approx(line[-2])  # it keeps its last good target


@pytest.mark.parametrize(
    ("acceleration", "kind"),
    [(4.9, None), (5.1, "joint_motion_generator_acceleration_discontinuity"),
     (10.1, "joint_motion_generator_velocity_discontinuity")],
)  # fmt: skip
def test_limits_of_acceleration_and_jerk(acceleration, kind):
    """From rest, 5000 rad/s³ allow 5 rad/s² in the first cycle."""
    robot = started(FrankaVelocitySettings())
    robot.step(rows(0, acceleration * H), rows(0))
    assert (robot.reflex and robot.reflex.kind) == kind


def test_the_limiter_keeps_the_limits_and_reaches_the_velocity():
    robot = started(FrankaVelocitySettings(limiter=True))
    found = driven(robot, [rows(0, 2.0)] * 400)
    assert robot.reflex is None
    assert np.abs(np.diff(found[:, 1])).max() / H <= 10.0 * (1 + 1e-9)
    assert np.abs(np.diff(found[:, 1], 2)).max() / H**2 <= 5000.0 * (1 + 1e-6)
    assert found[-1, 1] == pytest.approx(2.0)


@pytest.mark.parametrize(("step_nm", "limiter", "stops"), [(0.9, False, False), (1.1, False, True),
                                                          (1.1, True, False)])  # fmt: skip
def test_a_torque_step_beyond_1_nm_in_a_cycle_is_a_discontinuity(step_nm, limiter, stops):
    robot = started(FrankaTorqueSettings(limiter=limiter), joints=2)
    robot.step(np.array([[3.0, 7.0]]), np.zeros((2, 2)))  # the first torque is no step
    found = robot.step(np.array([[3.0, 7.0 + step_nm]]), np.zeros((2, 2)))
    if stops:
        assert robot.reflex.kind == "controller_torque_discontinuity"
        assert robot.reflex.joint == 1
    else:
        assert robot.reflex is None
        assert found[1] == pytest.approx(7.0 + min(step_nm, 1.0))


def test_a_lost_torque_is_held():
    robot = started(FrankaTorqueSettings())
    robot.step(np.array([[3.0]]), rows(0))
    assert [robot.step(None, rows(0)).tolist() for _ in range(19)] == [[3.0]] * 19


def test_the_filter_has_libfrankas_gain_and_is_fed_back():
    """T / (T + 1 / 2πf) at 100 Hz is 0.3859, of what is left each time."""
    robot = started(FrankaTorqueSettings(filter_hz=100.0, torque_rate_nm_s=1e6))
    robot.step(np.zeros((1, 1)), rows(0))
    found = [robot.step(np.ones((1, 1)), rows(0))[0] for _ in range(3)]
    np.testing.assert_allclose(found, 1.0 - (1.0 - 0.3859) ** np.arange(1, 4), atol=1e-4)

import math

import numpy as np
import pytest

from bus_schema.configuration import ConfigurationError
from controller.manipulator_model import ManipulatorModel
from controller.reference import CartesianPath, JointSinusoids, MinimumJerk, sample_positions
from deploy.scenario.scenario import load_setup
from tests.arms import PAPER_ARM, shipped_arm

# The nominal path: x = 0.85 − 0.01 t, y = 0.2 + 0.2 sin 0.5 t, z = 0.7 + 0.2 cos 0.5 t.
PAPER_AXES = np.array(
    [
        [0.85, -0.01, 0.0, 0.0, 0.0],
        [0.2, 0.0, 0.2, 0.5, 0.0],
        [0.7, 0.0, 0.2, 0.5, 0.5 * math.pi],
    ]
)
PAPER_PATH = CartesianPath(PAPER_AXES, 0.25, 0.70, 0.60)
FAST_AXES = np.array(
    [[0.7, 0.02, 0.1, 3.0, 1.0], [-0.1, 0.05, 0.3, 2.0, 0.3], [0.5, 0.0, 0.2, 4.0, 2.0]]
)
SINUSOIDS = JointSinusoids(
    np.array([0.1, -0.4]),
    np.array([[[0.3, 2.0, 0.5], [0.2, 5.0, 1.0]], [[0.1, 7.0, 0.0], [0.05, 11.0, 2.0]]]),
)
WAYPOINTS = MinimumJerk(np.array([1.0, 2.5, 3.0]), np.array([[0.0, 1.0], [1.0, -1.0], [0.5, -1.0]]))
REFERENCES = {
    "paper path": (PAPER_PATH, 3, np.linspace(0.1, 19.9, 67)),
    "fast path": (CartesianPath(FAST_AXES, 0.25, 0.70, 0.60), 3, np.linspace(0.1, 3.9, 67)),
    "sinusoids": (SINUSOIDS, 2, np.linspace(0.0, 10.0, 67)),
    "minimum jerk": (WAYPOINTS, 2, np.linspace(0.51, 3.49, 67)),
}


def motion(reference, time_s, joints):
    """Position, velocity and acceleration."""
    rows = np.empty((3, joints))
    reference.evaluate(time_s, *rows)
    return rows


@pytest.mark.parametrize("name", REFERENCES)
def test_velocity_and_acceleration_are_derivatives(name):
    reference, joints, times = REFERENCES[name]
    step = 1e-3
    for time_s in times:
        shifted = [motion(reference, time_s + k * step, joints) for k in (-2, -1, 1, 2)]
        numeric = (shifted[0] - 8 * shifted[1] + 8 * shifted[2] - shifted[3]) / (12 * step)
        _, velocity, acceleration = motion(reference, time_s, joints)
        # Fourth order: (11 rad/s × 1 ms)⁴ is 1e-8; an omitted term is of the order of 1.
        np.testing.assert_allclose(velocity, numeric[0], atol=1e-7, rtol=1e-7)
        np.testing.assert_allclose(acceleration, numeric[1], atol=1e-6, rtol=1e-6)


def test_tool_follows_the_whole_paper_path_elbow_up():
    model = ManipulatorModel(PAPER_ARM)
    assert model.yaw_pitch_pitch_lengths() == pytest.approx((0.25, 0.70, 0.60), abs=1e-12)
    times = np.arange(0.0, 20.0, 0.02)
    positions = sample_positions(PAPER_PATH, times, 3)
    for time_s, position in zip(times, positions, strict=True):
        tool = (
            0.85 - 0.01 * time_s,
            0.2 + 0.2 * math.sin(0.5 * time_s),
            0.7 + 0.2 * math.cos(0.5 * time_s),
        )
        np.testing.assert_allclose(model.tip_position(position), tool, atol=1e-12)
        elbow_height = 0.25 - 0.70 * math.sin(position[1])
        reach = math.hypot(tool[0], tool[1])
        line_height = 0.25 + (tool[2] - 0.25) * 0.70 * math.cos(position[1]) / reach
        assert elbow_height > line_height


@pytest.mark.parametrize(
    ("distance", "is_reached"), [(1.31, False), (1.29, True), (0.11, True), (0.09, False)]
)
def test_path_out_of_reach_is_nan(distance, is_reached):
    # The arm of 0.7 and 0.6 m reaches from 0.1 to 1.3 m around its shoulder.
    axes = np.array([[distance, 0, 0, 0, 0], [0, 0, 0, 0, 0], [0.25, 0, 0, 0, 0]], dtype=float)
    rows = motion(CartesianPath(axes, 0.25, 0.70, 0.60), 0.0, 3)
    assert (np.isfinite(rows) if is_reached else np.isnan(rows))[:, 1:].all()


def test_cartesian_path_needs_a_yaw_pitch_pitch_arm():
    with pytest.raises(ConfigurationError, match="three-joint arm"):
        ManipulatorModel(shipped_arm("iiwa")).yaw_pitch_pitch_lengths()


def test_minimum_jerk_rests_before_at_and_after_every_waypoint():
    for time_s, expected in [
        (-5.0, (0.0, 1.0)), (0.0, (0.0, 1.0)), (1.0, (0.0, 1.0)),
        (2.5, (1.0, -1.0)), (3.0, (0.5, -1.0)), (99.0, (0.5, -1.0)),
    ]:  # fmt: skip
        position, velocity, acceleration = motion(WAYPOINTS, time_s, 2)
        np.testing.assert_allclose(position, expected, atol=1e-15)
        assert velocity.tolist() == [0.0, 0.0]
        assert acceleration.tolist() == [0.0, 0.0]


def test_minimum_jerk_is_the_quintic_of_least_jerk():
    # From rest to rest over a distance d in time T: half way at T/2, with 15/8 d/T,
    # largest acceleration 10/√3 d/T² at T (3 − √3)/6.
    position, velocity, acceleration = motion(WAYPOINTS, 1.75, 2)
    assert position.tolist() == pytest.approx([0.5, 0.0])
    assert velocity.tolist() == pytest.approx([1.875 / 1.5, 1.875 * -2.0 / 1.5])
    assert acceleration.tolist() == pytest.approx([0.0, 0.0], abs=1e-12)
    steepest = motion(WAYPOINTS, 1.0 + 1.5 * (3.0 - math.sqrt(3.0)) / 6.0, 2)[2]
    assert steepest[0] == pytest.approx(10.0 / math.sqrt(3.0) / 1.5**2)


def test_single_waypoint_is_a_place_to_stay():
    still = MinimumJerk(np.array([2.0]), np.array([[0.3, -0.3]]))
    for time_s in (0.0, 2.0, 5.0):
        assert motion(still, time_s, 2).tolist() == [[0.3, -0.3], [0.0, 0.0], [0.0, 0.0]]


JERK = (
    '{"kind": "minimum_jerk", "speed": %s, "waypoints":'
    ' [{"time_s": 0.5, "position_rad": 0.2}, {"time_s": 3, "position_rad": 0.6}]}'
)


@pytest.mark.parametrize("name", ["paper_arm", "iiwa", "minimum jerk"])
def test_a_reference_of_twice_the_speed_is_at_twice_the_time(name):
    def at_speed(speed):
        if name == "minimum jerk":
            return load_setup("iiwa", ["reference=" + JERK % speed, "duration_s=1"])
        return load_setup(name, [f"reference.speed={speed}", "duration_s=1"])

    slow, fast = at_speed(1), at_speed(2)
    joints = slow.robot.joints
    for time_s in (0.0, 0.4, 0.9, 1.3):
        position, velocity, acceleration = motion(slow.reference, 2.0 * time_s, joints)
        rows = motion(fast.reference, time_s, joints)
        np.testing.assert_allclose(rows[0], position, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(rows[1], 2.0 * velocity, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(rows[2], 4.0 * acceleration, rtol=1e-12, atol=1e-12)

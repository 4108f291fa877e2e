"""The reference that follows from what a robot's client asks for."""

import json

import numpy as np
import pytest

from controller.reference import sample_motion
from controller.reference_configuration import CsvConfiguration
from deploy.run.asked_motion import AskedMotion
from deploy.scenario.scenario import load_setup

H = 1e-3
NONE = np.full(6, np.nan)


@pytest.fixture(scope="module")
def robot():
    return load_setup("ur5e_motors").robot


def reference_of(robot, file, targets):
    """Positions and velocities of the first joint at each tick, from a target for each tick."""
    asked = AskedMotion(H, robot.lower_rad, robot.upper_rad)
    for tick, target in enumerate(targets):
        asked.add(tick * H, np.zeros(6), target)
    asked.write(file, robot.joint_names)
    reference = CsvConfiguration(kind="csv", file=str(file), beyond="hold").build(robot)
    position, velocity = sample_motion(reference, H * np.arange(len(targets)), 6)[:2]
    return position[:, 0], velocity[:, 0]


def test_a_ramp_sent_in_steps_is_the_line_through_them(robot, tmp_path):
    """0.3 rad/s, a target every 20 ticks."""
    steps = [np.full(6, 0.3 * 20 * H * (tick // 20)) for tick in range(1001)]
    position, velocity = reference_of(robot, tmp_path / "a.csv", steps)
    inner = slice(40, 961)
    assert position[inner] == pytest.approx(0.3 * H * np.arange(1001)[inner], abs=1e-9)
    assert velocity[inner] == pytest.approx(0.3, abs=1e-6)


def test_rows_inside_a_line_are_left_out_and_the_motion_stays(robot, tmp_path):
    """A minute: rest, 0.02 rad/s, then a sine, which no line joins; all within 1e-8 rad of it."""
    times_s = H * np.arange(60_001)
    asked = 0.02 * np.clip(times_s - 10.0, 0.0, 45.0)
    asked += 0.2 * np.sin(np.clip(times_s - 58.0, 0.0, None))
    file = tmp_path / "a.csv"
    position, velocity = reference_of(robot, file, [np.full(6, each) for each in asked])
    assert position == pytest.approx(asked, abs=1e-8)
    assert velocity[11_000:54_000] == pytest.approx(0.02, abs=1e-8)
    assert velocity[58_100:59_400] == pytest.approx(
        0.2 * np.cos(times_s[58_100:59_400] - 58.0), abs=1e-5
    )
    times = np.loadtxt(file, delimiter=",", skiprows=1, usecols=0)
    assert (times < 58.0).sum() < 100
    assert (times >= 58.0).sum() >= 2000


def test_it_knows_when_the_client_began_and_last_moved_its_target(robot):
    """Idle up to 1 s, a ramp up to 2 s, the same target up to 3 s, idle after it."""
    asked = AskedMotion(H, robot.lower_rad, robot.upper_rad)
    assert (asked.first_s, asked.last_s) == (None, None)
    for tick in range(4001):
        at = NONE if not 1000 <= tick < 3000 else np.full(6, 1e-3 * min(tick - 1000, 1000))
        asked.add(tick * H, np.zeros(6), at)
    assert (asked.first_s, asked.last_s) == (1.0, 2.0)


def test_a_long_idle_run_has_few_rows(robot, tmp_path):
    asked = AskedMotion(H, robot.lower_rad, robot.upper_rad)
    for tick in range(0, 100_000, 20):
        asked.add(tick * H, np.full(6, 0.5), NONE)
    asked.write(tmp_path / "a.csv", robot.joint_names)
    assert len((tmp_path / "a.csv").read_text().splitlines()) < 150


@pytest.mark.parametrize(("period_ns", "start"), [(1_000_000, 8081), (2_000_000, 2018),
                                                 (4_000_000, 1082), (8_000_000, 1003)])  # fmt: skip
def test_a_target_one_tick_after_an_idle_row_adds_no_row_at_the_same_time(
    robot, tmp_path, period_ns, start
):
    """Seconds are rounded: at these ticks, the tick before seems later than itself."""
    asked = AskedMotion(1e-9 * period_ns, robot.lower_rad, robot.upper_rad)
    for tick in range(start + 3):
        target = NONE if tick < start else np.full(6, 0.5 + 0.01 * tick)
        asked.add(1e-9 * (tick * period_ns), np.full(6, 1e-3 * (tick % 7)), target)
    asked.write(tmp_path / "a.csv", robot.joint_names)
    CsvConfiguration(kind="csv", file=str(tmp_path / "a.csv"), beyond="hold").build(robot)


def test_a_jump_takes_a_tick_and_passes_neither_position(robot, tmp_path):
    targets = 300 * [NONE] + 300 * [np.full(6, 0.1)] + 300 * [np.full(6, 0.3)] + 100 * [NONE]
    position, _ = reference_of(robot, tmp_path / "a.csv", targets)
    assert position[:299] == pytest.approx(0.0)
    assert position[300:599] == pytest.approx(0.1)
    assert position[600:899] == pytest.approx(0.3)
    assert position[901:] == pytest.approx(0.0)
    assert (np.diff(position[:900]) >= -1e-12).all()
    assert position.max() <= 0.3 + 1e-12


@pytest.mark.parametrize("jump_rad", [0.005, 0.1, -1.0, 50.0])
def test_a_run_with_a_jump_is_judged(robot, tmp_path, jump_rad):
    """Of 50 rad, which is beyond the range of the joint, too."""
    file = tmp_path / "a.csv"
    targets = 1500 * [np.zeros(6)] + 500 * [np.full(6, jump_rad)]
    position, _ = reference_of(robot, file, targets)
    assert position[:1499] == pytest.approx(0.0, abs=1e-12)
    assert position[1500] == pytest.approx(min(jump_rad, robot.upper_rad[0]), abs=1e-9)
    reference = {"kind": "csv", "file": str(file), "beyond": "hold"}
    setup = load_setup("ur5e_motors", ["duration_s=2", f"reference={json.dumps(reference)}"])
    between_s = 1.499 + H * np.array([0.25, 0.5, 0.75])  # no tick shows these
    halfway = sample_motion(setup.reference, between_s, 6)[0][:, 0] / position[1500]
    assert halfway == pytest.approx([0.25, 0.5, 0.75], abs=3e-3)


def test_without_targets_the_reference_is_the_measured_motion(robot, tmp_path):
    asked = AskedMotion(H, robot.lower_rad, robot.upper_rad)
    for tick in range(501):
        asked.add(tick * H, np.full(6, np.sin(tick * H)), NONE)
    asked.write(tmp_path / "a.csv", robot.joint_names)
    reference = CsvConfiguration(kind="csv", file=str(tmp_path / "a.csv"), beyond="hold")
    times_s = np.arange(30, 470) * H
    position = sample_motion(reference.build(robot), times_s, 6)[0][:, 0]
    assert position == pytest.approx(np.sin(times_s), abs=1e-4)

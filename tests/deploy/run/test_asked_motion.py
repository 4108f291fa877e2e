"""The reference that follows from what a robot's client asks for."""

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
    asked = AskedMotion(H)
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


def test_a_jump_takes_a_tick_and_passes_neither_position(robot, tmp_path):
    targets = 300 * [NONE] + 300 * [np.full(6, 0.1)] + 300 * [np.full(6, 0.3)] + 100 * [NONE]
    position, _ = reference_of(robot, tmp_path / "a.csv", targets)
    assert position[:299] == pytest.approx(0.0)
    assert position[300:599] == pytest.approx(0.1)
    assert position[600:899] == pytest.approx(0.3)
    assert position[901:] == pytest.approx(0.0)
    assert (np.diff(position[:900]) >= -1e-12).all()
    assert position.max() <= 0.3 + 1e-12


def test_without_targets_the_reference_is_the_measured_motion(robot, tmp_path):
    asked = AskedMotion(H)
    for tick in range(501):
        asked.add(tick * H, np.full(6, np.sin(tick * H)), NONE)
    asked.write(tmp_path / "a.csv", robot.joint_names)
    reference = CsvConfiguration(kind="csv", file=str(tmp_path / "a.csv"), beyond="hold")
    times_s = np.arange(30, 470) * H
    position = sample_motion(reference.build(robot), times_s, 6)[0][:, 0]
    assert position == pytest.approx(np.sin(times_s), abs=1e-4)

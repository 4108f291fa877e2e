"""The dead time of actuators: torques and targets act later, by whole physics steps."""

import numpy as np
import pytest

from bus_schema.drive_feedback import DriveGains
from bus_schema.runtime.clock import TickGrid
from bus_schema.runtime.modes import Mode
from plant_emulator.arm.delay_line import DelayLine, DriveCommand
from plant_emulator.arm_plant import ArmPlant
from plant_emulator.configuration import PlantConfiguration
from tests.arms import PAPER_ARM

GRID = TickGrid(1000.0, 4)
START = np.array([0.3, -0.9, 1.2])
TORQUE = np.array([3.0, -150.0, -20.0])


@pytest.fixture
def arm_of():
    arms = []

    def of(delay_ms, gains=None, **more):
        sections = {"actuator": {"delay_ms": delay_ms}, "physics": {"engine": "mujoco"}, **more}
        plant = PlantConfiguration.model_validate(sections)
        arms.append(ArmPlant(plant, PAPER_ARM, START, GRID, 0, drive=gains))
        arms[-1].begin()
        return arms[-1]

    yield of
    for arm in arms:
        arm.close()


def motion_after(arm, substeps, until):
    """Positions after each of so many single substeps, shape (substeps, joints)."""
    rows = []
    for number in range(substeps, until):
        arm.advance(number, number + 1)
        rows.append(arm.position.copy())
    return np.array(rows)


@pytest.mark.parametrize(("delay_ms", "substeps"), [(0.25, 1), (2.6, 10), (20.0, 80)])
def test_arm_stands_for_the_dead_time_and_then_moves_as_without(arm_of, delay_ms, substeps):
    late, at_once = arm_of(delay_ms), arm_of(0.0)
    late.command(TORQUE)
    at_once.command(TORQUE)
    assert late.mode is Mode.TRACKING
    late.advance(0, substeps)  # in one call
    assert np.array_equal(late.position, START)  # brakes hold until the torque acts
    moved = motion_after(late, substeps, substeps + 40)
    np.testing.assert_array_equal(moved, motion_after(at_once, 0, 40))


def test_commands_between_substeps_act_in_their_order(arm_of):
    arm = arm_of(1.0)
    found = []
    for number in range(12):
        if number < 6:
            arm.command(np.full(3, float(number)))
        arm.advance(number, number + 1)
        found.append(arm.torques.actuator[0])
    assert found[:4] == [0.0] * 4
    assert found[4:10] == [float(number) for number in range(6)]
    assert found[10:] == [5.0, 5.0]


def test_arrays_of_the_sender_may_change_meanwhile(arm_of):
    arm, torque = arm_of(1.0), TORQUE.copy()
    arm.command(torque)
    torque[:] = 0.0
    arm.advance(0, 5)
    np.testing.assert_allclose(arm.torques.actuator, TORQUE)


def test_stop_forgets_the_commands_on_their_way(arm_of):
    arm = arm_of(1.0, safe_stop="zero_torque")
    arm.command(TORQUE)
    arm.advance(0, 5)
    arm.command(2.0 * TORQUE)
    arm.stop()
    arm.advance(5, 12)
    assert not arm.torques.actuator.any()


def test_drives_own_loop_is_not_delayed_but_its_target_is(arm_of):
    """A spring pulls to its first target at once after the dead time, and then without any."""
    gains = DriveGains(True, np.full(3, 500.0), np.full(3, 20.0))
    late, at_once = arm_of(5.0, gains), arm_of(0.0, gains)
    target = np.array([START + 0.1, np.zeros(3)])
    late.command(TORQUE, target)
    at_once.command(TORQUE, target)
    late.advance(0, 20)
    moved = motion_after(late, 20, 60)
    np.testing.assert_array_equal(moved, motion_after(at_once, 0, 40))


def test_line_of_no_substeps_keeps_nothing():
    line = DelayLine(0)
    line.put(DriveCommand(TORQUE, None, 0))
    assert len(line.take_due(0)) == 1
    assert line.take_due(10**9) == []

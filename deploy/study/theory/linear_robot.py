"""A robot with a controller of its own as a linear system, from targets to measured positions.

Without limits, `speedj` integrates velocities; robots with a `Response` follow positions with a
dead time and second order, q̈ + 2 ω q̇ + ω² q = ω² q*.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deploy.scenario.setup import Setup
from deploy.study.theory.linear_plant import LinearPlant
from plant_emulator.interfaces.joint_trajectory import JointTrajectorySettings
from plant_emulator.interfaces.settings import ResponseSettings
from plant_emulator.interfaces.speedj import SpeedJSettings


class LinearRobot(NamedTuple):
    """A robot as a plant that targets drive, and what delays them.

    Attributes:
        plant: its inputs are targets instead of torques.
        row: of a law's targets that the robot takes: 0 for positions, 1 for velocities.
        dead_s: time in which a target has no effect.
        shows_velocity: the outputs have velocities; zeros otherwise.
    """

    plant: LinearPlant
    row: int
    dead_s: float
    shows_velocity: bool


def linear_robot(setup: Setup) -> LinearRobot | None:
    """Return a scenario's robot, or None for kinds that are not linear."""
    interface = setup.scenario.plant.interface
    settings, cycle_s, joints = interface.settings, interface.true_period_s, setup.robot.joints
    # Where a cycle is longer than a tick, each target is held for longer than the loop's period.
    held_s = max(0.0, 0.5 * (cycle_s - 1e-9 * setup.grid.period_ns))
    one = np.eye(joints)
    if isinstance(settings, SpeedJSettings):
        dynamics, outputs = 0.0 * one, np.vstack([one, 0.0 * one])
        plant = LinearPlant(dynamics, one, outputs, one)
        # A velocity is reached at constant acceleration over a cycle: half a cycle later.
        return LinearRobot(plant, 1, held_s + 0.5 * cycle_s, shows_velocity=False)
    if not isinstance(settings, ResponseSettings) or isinstance(settings, JointTrajectorySettings):
        return None
    dead_ms, lag_ms = settings.response_ms
    if not lag_ms:
        return None
    bandwidth = 2e3 / lag_ms
    dynamics = np.kron(np.array([[0.0, 1.0], [-(bandwidth**2), -2.0 * bandwidth]]), one)
    inputs = np.kron(np.array([[0.0], [bandwidth**2]]), one)
    plant = LinearPlant(dynamics, inputs, np.eye(2 * joints), one)
    dead_s = held_s + cycle_s * round(1e-3 * dead_ms / cycle_s)
    return LinearRobot(plant, 0, dead_s, shows_velocity=True)

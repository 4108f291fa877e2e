"""The bound on a law's settling time on the arm that it is tried on."""

from __future__ import annotations

import math

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.robot_description import RobotDescription
from controller.manipulator_model import ManipulatorModel
from deploy.scenario import Setup

_POSITIONS = 500


def settling_bound_s(setup: Setup) -> float | None:
    """The law's bound for this arm with its payload, s; None for a law that has none.

    The largest inertia is the largest found in positions spread over all joint ranges, not only on
    the reference: one bound for every start.
    """
    model = ManipulatorModel(setup.robot, payload_kg=setup.scenario.plant.payload_kg)
    positions = spread_positions(setup.robot)

    def largest_inertia(weights: Vector) -> float:
        return model.largest_inertia(positions, weights)

    return setup.scenario.controller.settling_bound_s(setup.gains, largest_inertia)


def spread_positions(robot: RobotDescription) -> Matrix:
    """Joint positions all over the joint ranges, always the same, shape (samples, joints), rad.

    Zero, and a multiple of the square roots of primes modulo one, which fills the ranges evenly.
    """
    lower = np.where(np.isfinite(robot.lower_rad), robot.lower_rad, -math.pi)
    upper = np.where(np.isfinite(robot.upper_rad), robot.upper_rad, math.pi)
    steps = np.sqrt(_primes(robot.joints))
    spread = np.outer(np.arange(_POSITIONS), steps) % 1.0
    straight = np.clip(np.zeros(robot.joints), lower, upper)
    return np.vstack([straight, lower + spread * (upper - lower)])


def _primes(count: int) -> Vector:
    found: list[int] = []
    number = 2
    while len(found) < count:
        if all(number % prime for prime in found):
            found.append(number)
        number += 1
    return np.array(found, dtype=np.float64)

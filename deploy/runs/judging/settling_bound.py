"""The bound on a law's settling time on the arm that it is tried on."""

from __future__ import annotations

import math
from itertools import count, islice

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.robot_description import RobotDescription
from controller.manipulator_model import ManipulatorModel
from deploy.scenario.setup import Setup

_POSITIONS = 500

_largest_inertias: dict[tuple[str, float, bytes], float] = {}
"""By arm, payload and weights: the runs of a study mostly share them."""


def settling_bound_s(setup: Setup) -> float | None:
    """The law's bound for this arm with its payload, s; None for a law that has none.

    The largest inertia is the largest found in positions spread over all joint ranges, not only on
    the reference: one bound for every start.
    """
    robot, payload_kg = setup.robot, setup.scenario.plant.payload_kg

    def largest_inertia(weights: Vector) -> float:
        arm = (robot.text, payload_kg, weights.tobytes())
        if arm not in _largest_inertias:
            model = ManipulatorModel(robot, payload_kg=payload_kg)
            _largest_inertias[arm] = model.largest_inertia(spread_positions(robot), weights)
        return _largest_inertias[arm]

    return setup.scenario.controller.settling_bound_s(setup.gains, largest_inertia)


def spread_positions(robot: RobotDescription) -> Matrix:
    """Joint positions all over the joint ranges, always the same, shape (samples, joints), rad.

    Zero, and a multiple of the square roots of primes modulo one, which fills the ranges evenly.
    """
    lower = np.where(np.isfinite(robot.lower_rad), robot.lower_rad, -math.pi)
    upper = np.where(np.isfinite(robot.upper_rad), robot.upper_rad, math.pi)
    primes = (
        number for number in count(2) if all(number % divisor for divisor in range(2, number))
    )
    steps = np.sqrt(list(islice(primes, robot.joints)))
    spread = np.outer(np.arange(_POSITIONS), steps) % 1.0
    straight = np.clip(np.zeros(robot.joints), lower, upper)
    return np.vstack([straight, lower + spread * (upper - lower)])

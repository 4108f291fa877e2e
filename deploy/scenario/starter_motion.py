"""The motion of a first scenario: to and fro, within the limits of range, speed and torque."""

from __future__ import annotations

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.robot_description import RobotDescription
from controller.manipulator_model import ManipulatorModel, spread_positions
from controller.rigid_bodies.vectors import product

_SPEED_SHARE = 0.3
_TORQUE_SHARE, _HELD_SHARE = 0.7, 0.5
"""Shares of rated torque, along a move and for gravity alone."""
_REACH_SHARE = 0.2
"""Share of a joint's range, to either side of the middle of the reference."""
_LARGEST_MOVE = 0.5
_OFFSET_SHARE = 0.1
_SHED_PER_S, _SHED_S = 9.0, 0.05
_UNKNOWN_SPEED = 1.0
_LEAST_MOVE_S = 1.0
_PEAK_SPEED = 1.875
"""Peak speed of a minimum-jerk move of length 1 in time 1."""
_TRIES = 12


def middle_and_move(
    robot: RobotDescription, model: ManipulatorModel, rated: Vector
) -> tuple[Vector, Vector]:
    """Return the middle of the motion, and its amplitude to either side; shape (joints,).

    The middle is zero if the joints' ranges contain it; for an arm that hardly holds itself up
    there, it is the one of many postures with the least load.
    """
    lower, upper = _range(robot)
    zero = np.where((lower < 0.0) & (upper > 0.0), 0.0, 0.5 * (lower + upper))
    move = np.minimum(_REACH_SHARE * (upper - lower), _LARGEST_MOVE)
    margin = move + 0.1 * (upper - lower - 2.0 * move)
    best, least = zero, np.inf
    for posture in (zero, *spread_positions(robot)):
        middle = np.clip(posture, lower + margin, upper - margin)
        usage = float((_peak_torque(model, middle, move) / rated).max())
        if usage < least:
            best, least = middle, usage
        if least <= _HELD_SHARE:
            break
    return best, move


def start_offsets(model: ManipulatorModel, rated: Vector, start: Vector, move: Vector) -> Vector:
    """Return the joints' offset from the reference at the start, within motors' limits, (joints,).

    All joints together start towards the reference at `_SHED_PER_S` times the offset, within
    `_SHED_S`.
    """
    offsets = _OFFSET_SHARE * move * np.where(np.arange(move.size) % 2, -1.0, 1.0)
    needed = np.abs(product(model.mass_matrix(start), _SHED_PER_S / _SHED_S * offsets))
    left = np.maximum(rated - np.abs(model.gravity(start)), 0.0)
    return offsets * min(1.0, float((left / needed).min()))


def _range(robot: RobotDescription) -> tuple[Vector, Vector]:
    """Return the ends of the joints' ranges; continuous joints have half a turn each way."""
    return np.maximum(robot.lower_rad, -np.pi), np.minimum(robot.upper_rad, np.pi)


def move_time(
    robot: RobotDescription, model: ManipulatorModel, rated: Vector, middle: Vector, move: Vector
) -> float:
    """Return the time of a move from one end to the other within limits of speed and torque, s."""
    move_s = max(_LEAST_MOVE_S, float((_PEAK_SPEED * 2.0 * move / slow_speeds(robot)).max()))
    # Moving very slowly does not help an arm that hardly holds itself up.
    allowed = np.maximum(_TORQUE_SHARE * rated, 1.1 * _peak_torque(model, middle, move))
    for _ in range(_TRIES):
        if (_peak_torque(model, middle, move, move_s) <= allowed).all():
            break
        move_s *= 1.25
    return move_s


def _peak_torque(
    model: ManipulatorModel, middle: Vector, move: Vector, move_s: float = np.inf
) -> Vector:
    """Return the largest torque of each joint along a minimum-jerk move, shape (joints,), N m."""
    peaks: list[Vector] = []
    for s in np.linspace(0.0, 1.0, 11 if np.isinf(move_s) else 41):
        path = -1.0 + 2.0 * (10 * s**3 - 15 * s**4 + 6 * s**5)
        rate = 60 * s**2 * (1 - s) ** 2 / move_s
        change = 120 * s * (1 - s) * (1 - 2 * s) / move_s**2
        torque = model.inverse_dynamics(middle + path * move, rate * move, change * move)
        peaks.append(np.abs(torque))
    largest: Vector = np.array(peaks).max(axis=0)
    return largest


def slow_speeds(robot: RobotDescription) -> Vector:
    """Return upper limits of the reference's speeds, shape (joints,), rad/s."""
    limits = robot.velocity_limits_rad_s
    return _SPEED_SHARE * np.where(np.isfinite(limits), limits, _UNKNOWN_SPEED)

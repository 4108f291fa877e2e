"""A trajectory that shows an arm's parameters: a Fourier series within the arm's limits.

After Swevers, Ganseman, Tükel, De Schutter and Van Brussel, "Optimal robot excitation and
identification", IEEE Trans. Robotics and Automation 13(5), 1997; the series fades in and out, so
that the arm starts and ends at rest. The best of many random ones is kept.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Vector
from bus_schema.errors import InputError
from bus_schema.recording.atomic_files import write_whole
from bus_schema.robot_description import RobotDescription
from controller.manipulator_model import ManipulatorModel
from deploy.measure.identify.base_parameters import grouping
from deploy.measure.trace_output import write_table
from deploy.scenario.starter import torque_limits
from deploy.scenario.yaml_files import to_yaml

_BASE_HZ, _HARMONICS, _FADE_S = 0.1, 5, 2.0
_TRIES, _JUDGED, _RATE_HZ = 150, 120, 100.0
_RANGE, _SPEED, _TORQUE = 0.8, 0.6, 0.7
"""Shares of the limits that are used."""
_UNKNOWN_SPEED, _UNKNOWN_RANGE = 1.0, np.pi
_LARGEST_SWING = 1.2
_SHORTEST_S = 10.0


@dataclass(frozen=True)
class Design:
    """A trajectory.

    Attributes:
        times_s: shape (samples,).
        motion: position, velocity and acceleration, shape (3, samples, joints).
        condition: condition number of the regressor of the base parameters, its columns scaled.
    """

    times_s: Vector
    motion: NDArray[np.float64]
    condition: float


def design(robot: RobotDescription, duration_s: float) -> Design:
    """Return a trajectory that excites all joints within their limits.

    Raises:
        InputError: it is too short, or the arm cannot hold itself up where its ranges have their
            middle.
    """
    if not _SHORTEST_S <= duration_s <= 600.0:
        raise InputError(f"--duration {duration_s:g}: must be between {_SHORTEST_S:g} and 600 s")
    model, random = ManipulatorModel(robot), np.random.default_rng(1)
    group = grouping(model)
    inverse = np.linalg.pinv(group.matrix)
    times_s = np.arange(round(duration_s * _RATE_HZ) + 1) / _RATE_HZ
    limits_nm = _TORQUE * torque_limits(robot)
    best: Design | None = None
    for _ in range(_TRIES):
        motion = _series(random, times_s, robot)
        pick = np.linspace(0, len(times_s) - 1, _JUDGED).astype(int)
        chosen = motion[:, pick]
        torques = [model.inverse_dynamics(*row) for row in chosen.transpose(1, 0, 2)]
        if (np.abs(torques) > limits_nm).any():
            continue
        regressor = model.torque_regressors(*chosen).reshape(-1, inverse.shape[0]) @ inverse
        condition = float(np.linalg.cond(regressor / np.linalg.norm(regressor, axis=0)))
        if best is None or condition < best.condition:
            best = Design(times_s, motion, condition)
    if best is None:
        raise InputError(
            f"{robot.path}: no motion around the middle of the ranges keeps the joints below"
            f" {100 * _TORQUE:g} % of their largest torques"
        )
    return best


def _series(
    random: np.random.Generator, times_s: Vector, robot: RobotDescription
) -> NDArray[np.float64]:
    """Return a random motion within ranges and speeds, shape (3, samples, joints)."""
    lower = np.maximum(robot.lower_rad, -_UNKNOWN_RANGE)
    upper = np.minimum(robot.upper_rad, _UNKNOWN_RANGE)
    speeds = np.where(
        np.isfinite(robot.velocity_limits_rad_s), robot.velocity_limits_rad_s, _UNKNOWN_SPEED
    )
    waves = 2.0 * np.pi * _BASE_HZ * np.arange(1, _HARMONICS + 1)
    parts = random.normal(size=(2, _HARMONICS, robot.joints)) / waves[:, None]
    phases = np.outer(times_s, waves)
    end_s = np.minimum(times_s, times_s[-1] - times_s) / _FADE_S
    s = np.clip(end_s, 0.0, 1.0)
    fade = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    swing = fade[:, None] * (np.sin(phases) @ parts[0] + np.cos(phases) @ parts[1])
    rate = np.gradient(swing, times_s, axis=0)
    half = np.minimum(0.5 * _RANGE * (upper - lower), _LARGEST_SWING)
    fastest = np.abs(rate).max(axis=0)
    factor = np.minimum(half / np.abs(swing).max(axis=0), _SPEED * speeds / fastest)
    position = 0.5 * (lower + upper) + factor * swing
    velocity = factor * rate
    return np.array([position, velocity, np.gradient(velocity, times_s, axis=0)])


def write_design(found: Design, robot: RobotDescription, file: Path) -> Path:
    """Write a trajectory as CSV, and as a ROS JointTrajectory beside it; return that path.

    Raises:
        OSError: a file cannot be written.
    """
    kinds = ("position_rad", "velocity_rad_s", "acceleration_rad_s2")
    columns = {"time_s": found.times_s} | {
        f"{name}.{kind}": found.motion[k, :, j]
        for j, name in enumerate(robot.joint_names)
        for k, kind in enumerate(kinds)
    }
    write_table(columns, file, is_parquet=False)
    beside = file.with_suffix(".yaml")
    write_whole(beside, to_yaml(_joint_trajectory(found, robot)))
    return beside


def _joint_trajectory(found: Design, robot: RobotDescription) -> dict[str, Any]:
    """Return the fields of a ``trajectory_msgs/msg/JointTrajectory``, at a fifth of the rate."""
    points = []
    rows = found.motion[:, ::5].transpose(1, 0, 2).round(6).tolist()
    for time_s, values in zip(found.times_s[::5], rows, strict=True):
        whole, rest = divmod(round(1e9 * time_s), 1_000_000_000)
        named = zip(("positions", "velocities", "accelerations"), values, strict=True)
        points.append(dict(named) | {"time_from_start": {"sec": whole, "nanosec": rest}})
    return {"joint_names": list(robot.joint_names), "points": points}

"""Reference trajectories from CSV files: one row per time, named columns for each joint."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.configuration import LARGEST, ConfigurationError, shown
from bus_schema.robot_description import RobotDescription
from bus_schema.runtime.compiled import compiled
from bus_schema.tables import column_names, read_columns

KEY = "reference.file"
TIME = "time_s"
KINDS = ("position_rad", "velocity_rad_s", "acceleration_rad_s2")
"""Columns of a joint, as ``<joint>.<kind>``; in m for prismatic joints."""
KINDS_OF_SLIDING = ("position_m", "velocity_m_s", "acceleration_m_s2")
"""Other names of the same columns, for prismatic joints."""
_SHORTEST_STEP_S = 0.999e-6  # a microsecond, allowing for rounding of sums of seconds
_MOST_WARNINGS = 3
_AT_REST_RAD_S = 1e-3


@dataclass(frozen=True)
class ReferenceRows:
    """Content of a reference file.

    Attributes:
        file: its name as given.
        place: returns where a row, counted from 0, is in the file.
        times_s: increasing, shape (rows,).
        motion: position, velocity and acceleration, shape (rows, 3, joints).
    """

    file: str
    place: Callable[[int], str]
    times_s: Vector
    motion: Matrix

    def warnings(self, robot: RobotDescription, speed: float) -> tuple[str, ...]:
        """Return a sentence for each joint that would have to exceed its largest speed."""
        if len(self.times_s) < 2:
            return ()
        steps = np.diff(self.motion[:, 0], axis=0) * (speed / np.diff(self.times_s))[:, np.newaxis]
        too_fast = np.abs(steps) > robot.velocity_limits_rad_s
        warnings = [
            f"{self.file}, {self.place((row := int(np.argmax(too_fast[:, j]))) + 1)}: {name}"
            f" needs {abs(steps[row, j]):.4g} rad/s to get there, but its velocity limit is"
            f" {robot.velocity_limits_rad_s[j]:.4g}"
            for j, name in enumerate(robot.joint_names)
            if too_fast[:, j].any()
        ]
        return tuple(warnings[:_MOST_WARNINGS])

    def moves_at_an_end(self) -> bool:
        """Whether a joint moves in the first or last row."""
        return bool(np.any(np.abs(self.motion[[0, -1], 1]) > _AT_REST_RAD_S))


def read_rows(file: str, robot: RobotDescription) -> ReferenceRows:
    """Read a reference for an arm.

    Without a column of velocities, both derivatives of a joint come from the twice differentiable
    spline through its positions; without accelerations, these come from its velocities. Columns of
    other names are ignored.

    Raises:
        ConfigurationError: it cannot be read or is invalid; the message names line, column, value
            and what is allowed.
    """
    path = Path(file)
    try:
        header = column_names(path)
        kinds = dict(zip(robot.joint_names, _kinds(robot, header), strict=True))
        wanted = _wanted(path, header, kinds)
        columns = read_columns(path, wanted, None)
        if not columns.rows:
            raise ValueError("must have a row after its first line")
        for name, values in columns.values.items():
            allowed = f"must be a finite number of at most {LARGEST:g} in size"
            columns.refuse_where(~(np.abs(values) <= LARGEST), name, allowed)
        times_s = columns.values[TIME]
        is_late = np.concatenate([[False], np.diff(times_s) < _SHORTEST_STEP_S])
        allowed = "must be later than the time of the row before, by 1 us"
        columns.refuse_where(is_late, TIME, allowed)
    except ValueError as error:
        raise ConfigurationError(KEY, file, str(error).removeprefix(f"{path}, ")) from error
    joints = [_motion(columns.values, *own, times_s) for own in kinds.items()]
    return ReferenceRows(file, columns.place, times_s, np.stack(joints, axis=-1))


def _kinds(robot: RobotDescription, header: Sequence[str]) -> list[tuple[str, str, str]]:
    """Return the names of each joint's columns: in m if it slides, and its positions are so."""
    return [
        KINDS_OF_SLIDING if slides and f"{name}.{KINDS_OF_SLIDING[0]}" in header else KINDS
        for name, slides in zip(robot.joint_names, robot.slides, strict=True)
    ]


def _wanted(
    path: Path, header: Sequence[str], kinds: Mapping[str, tuple[str, str, str]]
) -> list[str]:
    """Return the columns to read; refuse misspelt ones of joints."""
    known = [f"{joint}.{kind}" for joint, own in kinds.items() for kind in own]
    for name in header:
        joint = next((each for each in kinds if name.startswith(f"{each}.")), None)
        if joint is not None and name not in known:
            allowed = f"the columns of a joint are {', '.join(f'<joint>.{kind}' for kind in KINDS)}"
            of_slides = f"; of one that slides also {', '.join(KINDS_OF_SLIDING)}"
            raise ValueError(f"{path}, line 1: column {shown(name)}: {allowed}{of_slides}")
    required = [TIME, *(f"{joint}.{own[0]}" for joint, own in kinds.items())]
    required += [
        f"{joint}.{own[1]}" for joint, own in kinds.items() if f"{joint}.{own[2]}" in header
    ]  # accelerations alone do not suffice
    return required + [name for name in known if name in header and name not in required]


def _motion(
    columns: Mapping[str, Vector], joint: str, kinds: tuple[str, str, str], times_s: Vector
) -> Matrix:
    """Return position, velocity and acceleration of a joint at each time, shape (rows, 3)."""
    position, velocity, acceleration = (columns.get(f"{joint}.{kind}") for kind in kinds)
    assert position is not None  # `_wanted` requires it
    if velocity is None:
        velocity = spline_slopes(times_s, position)
        acceleration = spline_curvatures(times_s, position, velocity)
    elif acceleration is None:
        acceleration = spline_slopes(times_s, velocity)
    return np.stack([position, velocity, acceleration], axis=-1)


def spline_slopes(times_s: Vector, values: Vector) -> Vector:
    """Return slopes of the twice differentiable cubic spline through values, shape (rows,).

    Its slopes at both ends are those of the cubic through the four values there.
    """
    slopes = np.zeros(len(values))
    if len(values) > 1:
        slopes[0] = _slope_at_first(times_s[:4], values[:4])
        slopes[-1] = -_slope_at_first(-times_s[:-5:-1], values[:-5:-1])
        _solve_for_slopes(times_s, values, slopes)
    return slopes


def spline_curvatures(times_s: Vector, values: Vector, slopes: Vector) -> Vector:
    """Return second derivatives of the spline with these slopes, shape (rows,)."""
    curvatures = np.zeros(len(values))
    if len(values) > 1:
        h = np.diff(times_s)
        steps = np.diff(values) / h
        curvatures[:-1] = (6.0 * steps - 4.0 * slopes[:-1] - 2.0 * slopes[1:]) / h
        curvatures[-1] = (-6.0 * steps[-1] + 2.0 * slopes[-2] + 4.0 * slopes[-1]) / h[-1]
    return curvatures


def _slope_at_first(times_s: Vector, values: Vector) -> float:
    """Return the slope at the first of up to four times of the polynomial through them (Newton)."""
    slope, differences, product = 0.0, values, 1.0
    for order in range(1, len(times_s)):
        differences = np.diff(differences) / (times_s[order:] - times_s[:-order])
        slope += product * differences[0]
        product *= times_s[0] - times_s[order]
    return float(slope)


@compiled
def _solve_for_slopes(times_s: Vector, values: Vector, slopes: Vector) -> None:
    """Solve for the slopes between the first and the last, which are given (Thomas's algorithm)."""
    rows = values.size
    upper = np.zeros(rows)
    for i in range(1, rows - 1):
        before, after = times_s[i] - times_s[i - 1], times_s[i + 1] - times_s[i]
        wanted = 3.0 * (
            (values[i] - values[i - 1]) / (before * before)
            + (values[i + 1] - values[i]) / (after * after)
        )
        pivot = 2.0 / before + 2.0 / after - upper[i - 1] / before
        upper[i] = 1.0 / after / pivot
        slopes[i] = (wanted - slopes[i - 1] / before) / pivot
    for i in range(rows - 2, 0, -1):
        slopes[i] -= upper[i] * slopes[i + 1]

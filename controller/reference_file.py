"""Reference trajectories from CSV files: one row per time, named columns for each joint."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.configuration import LARGEST, ConfigurationError, shown
from bus_schema.robot_description import RobotDescription
from bus_schema.runtime.compiled import compiled
from bus_schema.user_files import read_text

KEY = "reference.file"
TIME = "time_s"
KINDS = ("position_rad", "velocity_rad_s", "acceleration_rad_s2")
"""Columns of a joint, as ``<joint>.<kind>``; in m for prismatic joints."""
_SHORTEST_STEP_S = 0.999e-6  # a microsecond, allowing for rounding of sums of seconds
_LARGEST_BYTES = 50_000_000
_MOST_WARNINGS = 3
_AT_REST_RAD_S = 1e-3


@dataclass(frozen=True)
class ReferenceRows:
    """Content of a reference file.

    Attributes:
        file: its name as given.
        lines: number of each row's line, from 1, shape (rows,).
        times_s: increasing, shape (rows,).
        motion: position, velocity and acceleration, shape (rows, 3, joints).
    """

    file: str
    lines: Sequence[int]
    times_s: Vector
    motion: Matrix

    def warnings(self, robot: RobotDescription, speed: float) -> tuple[str, ...]:
        """Return a sentence for each joint that would have to exceed its largest speed."""
        if len(self.times_s) < 2:
            return ()
        steps = np.diff(self.motion[:, 0], axis=0) * (speed / np.diff(self.times_s))[:, np.newaxis]
        too_fast = np.abs(steps) > robot.velocity_limits_rad_s
        said = [
            f"{self.file}, line {self.lines[(row := int(np.argmax(too_fast[:, j]))) + 1]}: {name}"
            f" needs {abs(steps[row, j]):.4g} rad/s to get there, but its velocity limit is"
            f" {robot.velocity_limits_rad_s[j]:.4g}"
            for j, name in enumerate(robot.joint_names)
            if too_fast[:, j].any()
        ]
        return tuple(said[:_MOST_WARNINGS])

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
    try:
        text = read_text(Path(file), _LARGEST_BYTES, newline="").removeprefix("\ufeff")
        reader = csv.reader(io.StringIO(text, newline=""))
        header = [name.strip() for name in next(reader, [])]
        places = _places(file, header, robot.joint_names)
        cells = [(reader.line_num, row) for row in reader if any(map(str.strip, row))]
    except (OSError, csv.Error) as error:
        raise _wrong(file, f"cannot be read as CSV: {error}") from error
    for line, row in cells:
        if any(map(str.strip, row[len(header) :])):
            what = f"has {len(row)} values, the first line {len(header)} names: must have one each"
            raise _wrong(file, f"line {line} {what}")
    if not cells:
        raise _wrong(file, "must have a row after its first line")
    numbers = [number for number, _ in cells]
    columns = {
        name: np.array(list(_numbers(file, cells, name, place))) for name, place in places.items()
    }
    times_s = columns.pop(TIME)
    late = np.flatnonzero(np.diff(times_s) < _SHORTEST_STEP_S)
    if late.size:
        at = int(late[0]) + 1
        allowed = f"must be later than {times_s[at - 1]:g}, the time of the row before, by 1 us"
        raise _cell(file, numbers[at], TIME, f"{times_s[at]:g}", allowed)
    joints = [_motion(columns, name, times_s) for name in robot.joint_names]
    return ReferenceRows(file, numbers, times_s, np.stack(joints, axis=-1))


def _places(file: str, header: Sequence[str], joints: Sequence[str]) -> dict[str, int]:
    """Return the indices of the columns to read."""
    known = [f"{joint}.{kind}" for joint in joints for kind in KINDS]
    for name in header:
        of_joint = any(name.startswith(f"{joint}.") for joint in joints)
        if of_joint and name not in known:
            allowed = f"the columns of a joint are {', '.join(f'<joint>.{kind}' for kind in KINDS)}"
            raise _wrong(file, f"line 1: column {shown(name)}: {allowed}")
        if name in (TIME, *known) and header.count(name) > 1:
            raise _wrong(file, f"line 1: column {shown(name)}: must occur only once")
    required = [TIME, *(f"{joint}.{KINDS[0]}" for joint in joints)]
    required += [
        f"{joint}.{KINDS[1]}" for joint in joints if f"{joint}.{KINDS[2]}" in header
    ]  # accelerations alone do not suffice
    for name in required:
        if name not in header:
            found = ", ".join(header) or "none"
            raise _wrong(
                file, f"line 1: column {name!r} is missing; there are {shown(found)[1:-1]}"
            )
    return {name: header.index(name) for name in (TIME, *known) if name in header}


def _numbers(
    file: str, cells: Sequence[tuple[int, list[str]]], name: str, place: int
) -> Iterator[float]:
    """Return a column; refuse a value that is no number."""
    for line, row in cells:
        if place >= len(row):
            raise _cell(file, line, name, "", "must be a number; the line ends before")
        try:
            value = float(row[place])
        except ValueError:
            value = math.nan
        if not abs(value) <= LARGEST:
            allowed = f"must be a finite number of at most {LARGEST:g} in size"
            raise _cell(file, line, name, row[place].strip(), allowed)
        yield value


def _motion(columns: Mapping[str, Vector], joint: str, times_s: Vector) -> Matrix:
    """Return position, velocity and acceleration of a joint at each time, shape (rows, 3)."""
    position, velocity, acceleration = (columns.get(f"{joint}.{kind}") for kind in KINDS)
    assert position is not None  # `_places` has checked this
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


def _cell(file: str, line: int, column: str, value: str, allowed: str) -> ConfigurationError:
    return _wrong(file, f"line {line}, column {column} = {shown(value)}: {allowed}")


def _wrong(file: str, what: str) -> ConfigurationError:
    return ConfigurationError(KEY, file, what)

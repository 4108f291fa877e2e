"""Reference trajectories in joint space, with analytic first and second derivatives."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.runtime.compiled import bind, compiled


class Reference:
    """A joint trajectory over the time of a run.

    Args:
        kernel: compiled function of the parameters, of output arrays for position, velocity and
            acceleration, and of time.
        parameters: its first argument.
        warnings: warnings about a suspicious trajectory, a sentence each.
        known_s: first and last time at which it is defined.
    """

    def __init__(
        self,
        kernel: Callable[..., None],
        *parameters: Matrix | Vector | float,
        warnings: tuple[str, ...] = (),
        known_s: tuple[float, float] = (-math.inf, math.inf),
    ) -> None:
        self.warnings, self.known_s = warnings, known_s
        self._kernel = kernel
        self._parameters = [
            np.ascontiguousarray(given) if isinstance(given, np.ndarray) else given
            for given in parameters
        ]

    def copied(self) -> Reference:
        """Return the same trajectory in separate arrays."""
        parameters = (p.copy() if isinstance(p, np.ndarray) else p for p in self._parameters)
        return Reference(self._kernel, *parameters, warnings=self.warnings, known_s=self.known_s)

    def evaluate(
        self, time_s: float, position: Vector, velocity: Vector, acceleration: Vector
    ) -> None:
        """Write position (rad), velocity and acceleration at `time_s`, shape (joints,) each."""
        self._kernel(*self._parameters, position, velocity, acceleration, time_s)

    def onto(
        self, position: Vector, velocity: Vector, acceleration: Vector
    ) -> Callable[[float], None]:
        """Return `evaluate` as a function of time alone, always for the same arrays."""
        targets = (position, velocity, acceleration)
        return bind(self._kernel, *self._parameters, *targets, free=["float64"])


def sample_positions(reference: Reference, times_s: Vector, joints: int) -> Matrix:
    """Return reference positions at each time, shape (times, joints), rad."""
    return np.asarray(sample_motion(reference, times_s, joints)[0])


def sample_motion(
    reference: Reference, times_s: Vector, joints: int
) -> np.ndarray[tuple[int, int, int], np.dtype[np.float64]]:
    """Return reference positions and velocities at each time, shape (2, times, joints)."""
    motion = np.empty((2, len(times_s), joints))
    position, velocity, acceleration = np.empty((3, joints))
    follow = reference.onto(position, velocity, acceleration)
    for row, time_s in enumerate(times_s.tolist()):
        follow(time_s)
        motion[0, row], motion[1, row] = position, velocity
    return motion


@compiled
def _axis(time_s: float, axis: Vector) -> tuple[float, float, float]:
    offset, speed, amplitude, frequency, phase = axis[0], axis[1], axis[2], axis[3], axis[4]
    angle = frequency * time_s + phase
    sine = amplitude * math.sin(angle)
    return (
        offset + speed * time_s + sine,
        speed + frequency * amplitude * math.cos(angle),
        -frequency * frequency * sine,
    )


@compiled
def _cartesian_path(
    axes: Matrix, shoulder_height: float, upper_arm: float, forearm: float,
    position: Vector, velocity: Vector, acceleration: Vector, time_s: float,
) -> None:  # fmt: skip
    x, d_x, dd_x = _axis(time_s, axes[0])
    y, d_y, dd_y = _axis(time_s, axes[1])
    z, d_z, dd_z = _axis(time_s, axes[2])
    height = z - shoulder_height

    reach = math.sqrt(x * x + y * y)
    d_reach = (x * d_x + y * d_y) / reach
    dd_reach = (d_x * d_x + d_y * d_y + x * dd_x + y * dd_y - d_reach * d_reach) / reach
    d_yaw = (x * d_y - y * d_x) / (reach * reach)
    position[0] = math.atan2(y, x)
    velocity[0] = d_yaw
    acceleration[0] = (x * dd_y - y * dd_x) / (reach * reach) - 2.0 * d_reach * d_yaw / reach

    # Law of cosines for the elbow; a and b are the pitch of upper arm and forearm.
    cos_elbow = (reach * reach + height * height - upper_arm * upper_arm - forearm * forearm) / (
        2.0 * upper_arm * forearm
    )
    elbow = math.acos(cos_elbow) if abs(cos_elbow) <= 1.0 else math.nan
    a = math.atan2(-height, reach) - math.atan2(
        forearm * math.sin(elbow), upper_arm + forearm * math.cos(elbow)
    )
    b = a + elbow
    position[1], position[2] = a, elbow

    # reach = L1 cos a + L2 cos b, height = −L1 sin a − L2 sin b, differentiated once and twice.
    sin_a, cos_a = upper_arm * math.sin(a), upper_arm * math.cos(a)
    sin_b, cos_b = forearm * math.sin(b), forearm * math.cos(b)
    determinant = sin_a * cos_b - sin_b * cos_a
    d_a = (-cos_b * d_reach + sin_b * d_z) / determinant
    d_b = (cos_a * d_reach - sin_a * d_z) / determinant
    reach_rest = dd_reach + cos_a * d_a * d_a + cos_b * d_b * d_b
    height_rest = dd_z - sin_a * d_a * d_a - sin_b * d_b * d_b
    dd_a = (-cos_b * reach_rest + sin_b * height_rest) / determinant
    dd_b = (cos_a * reach_rest - sin_a * height_rest) / determinant
    velocity[1], velocity[2] = d_a, d_b - d_a
    acceleration[1], acceleration[2] = dd_a, dd_b - dd_a


@compiled
def _joint_sinusoids(
    centre: Vector, terms: Matrix,
    position: Vector, velocity: Vector, acceleration: Vector, time_s: float,
) -> None:  # fmt: skip
    for i in range(centre.size):
        position[i], velocity[i], acceleration[i] = centre[i], 0.0, 0.0
        for term in range(terms.shape[0]):
            amplitude, frequency, phase = terms[term, i, 0], terms[term, i, 1], terms[term, i, 2]
            angle = frequency * time_s + phase
            sine = amplitude * math.sin(angle)
            position[i] += sine
            velocity[i] += frequency * amplitude * math.cos(angle)
            acceleration[i] -= frequency * frequency * sine


@compiled
def _minimum_jerk(
    times: Vector, positions: Matrix,
    position: Vector, velocity: Vector, acceleration: Vector, time_s: float,
) -> None:  # fmt: skip
    segment = min(max(int(np.searchsorted(times, time_s)) - 1, 0), max(times.size - 2, 0))
    following = min(segment + 1, times.size - 1)
    duration = times[following] - times[segment]
    x = 0.0 if duration <= 0.0 else min(max((time_s - times[segment]) / duration, 0.0), 1.0)
    moving = 0.0 < x < 1.0
    shape = x * x * x * (10.0 + x * (6.0 * x - 15.0))
    d_shape = 30.0 * x * x * (1.0 - x) * (1.0 - x) / duration if moving else 0.0
    dd_shape = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / (duration * duration) if moving else 0.0
    for i in range(position.size):
        distance = positions[following, i] - positions[segment, i]
        position[i] = positions[segment, i] + distance * shape
        velocity[i] = distance * d_shape
        acceleration[i] = distance * dd_shape


@compiled
def _through_rows(
    times: Vector, rows: Matrix,
    position: Vector, velocity: Vector, acceleration: Vector, time_s: float,
) -> None:  # fmt: skip
    last = times.size - 1
    row = min(max(int(np.searchsorted(times, time_s, side="right")) - 1, 0), last)
    if time_s < times[0] or time_s > times[last]:
        for i in range(position.size):
            position[i], velocity[i], acceleration[i] = rows[row, 0, i], 0.0, 0.0
        return
    dt = time_s - times[row]
    for i in range(position.size):
        p, v, a = rows[row, 0, i], rows[row, 1, i], rows[row, 2, i]
        c3 = c4 = c5 = 0.0
        if row < last:
            # The quintic with the position, velocity and acceleration of both rows; at a row's
            # time it returns the row's values, to the bit.
            h = times[row + 1] - times[row]
            off = rows[row + 1, 0, i] - (p + h * (v + 0.5 * h * a))
            d_off = (rows[row + 1, 1, i] - (v + h * a)) * h
            dd_off = (rows[row + 1, 2, i] - a) * h * h
            c3 = (10.0 * off - 4.0 * d_off + 0.5 * dd_off) / (h * h * h)
            c4 = (-15.0 * off + 7.0 * d_off - dd_off) / (h * h * h * h)
            c5 = (6.0 * off - 3.0 * d_off + 0.5 * dd_off) / (h * h * h * h * h)
        position[i] = p + dt * (v + dt * (0.5 * a + dt * (c3 + dt * (c4 + dt * c5))))
        velocity[i] = v + dt * (a + dt * (3.0 * c3 + dt * (4.0 * c4 + dt * 5.0 * c5)))
        acceleration[i] = a + dt * (6.0 * c3 + dt * (12.0 * c4 + dt * 20.0 * c5))


CartesianPath = partial(Reference, _cartesian_path)
"""A path of the tool of a yaw-pitch-pitch arm, through analytic inverse kinematics, elbow up.

Args:
    axes: shape (3, 5): offset (m), velocity (m/s), amplitude (m), frequency (rad/s) and
        phase (rad) of x, y and z: offset + velocity t + amplitude sin(frequency t + phase).
    shoulder_height_m: height of the shoulder above the base.
    upper_arm_m: shoulder to elbow.
    forearm_m: elbow to tool.

Where the path is out of reach, the angles of shoulder and elbow are NaN.
"""

JointSinusoids = partial(Reference, _joint_sinusoids)
"""Each joint moves as centre + Σ amplitude sin(frequency t + phase).

Args:
    centre_rad: shape (joints,).
    terms: shape (terms, joints, 3): amplitude (rad), frequency (rad/s), phase (rad).
"""

MinimumJerk = partial(Reference, _minimum_jerk)
"""Rest-to-rest moves through waypoints, each a quintic of least jerk; at rest before and after.

Args:
    times_s: increasing, shape (waypoints,).
    positions_rad: shape (waypoints, joints).
"""

ThroughRows = partial(Reference, _through_rows)
"""Through rows of position, velocity and acceleration, a quintic between two; at rest beyond them.

Args:
    times_s: increasing, shape (rows,).
    rows: shape (rows, 3, joints): rad, rad/s, rad/s².
"""

"""The lag of joints: the time by which they are behind their reference."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Vector
from bus_schema.messages import topics
from deploy.judge.run_data import RunData

_MS = 1e3
_STILL_RAD_S = 1e-6
"""RMS of a reference's velocity; slower ones show no lag."""
_HALF_S = 0.05
"""Half of the time over which the speed of a target is taken."""


def lag_ms(run: RunData) -> list[float | None]:
    """Return the lag of each joint's true error, ms, from ``metrics.from_s`` on.

    None for a joint whose reference rests, and negative for one that is ahead.
    """
    judged = run.times_s(topics.PLANT_TRUTH) >= run.setup.scenario.metrics.from_s
    errors, speeds = run.true_errors_rad[judged], run.reference_velocities_rad_s[judged]
    return [_MS * float(each) if np.isfinite(each) else None for each in lags_s(errors, speeds)]


def lags_s(
    errors_rad: NDArray[np.float64], velocities_rad_s: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the time T of e = −T q̇_d, s, by least squares over all ticks; NaN where q̇_d rests.

    Args:
        errors_rad: shape (ticks,) or (ticks, joints).
        velocities_rad_s: of the reference, same shape.
    """
    square = (velocities_rad_s**2).sum(axis=0)
    with np.errstate(invalid="ignore", over="ignore"):
        product = (errors_rad * velocities_rad_s).sum(axis=0)
        return _quotient(product, square, len(velocities_rad_s))


def _quotient(
    product: NDArray[np.float64], square: NDArray[np.float64], rows: int
) -> NDArray[np.float64]:
    moves = square > _STILL_RAD_S**2 * max(rows, 1)
    return np.asarray(-product / np.where(moves, square, np.nan))


class LagMeter:
    """The lag of joints behind targets that come in steps, row by row, in bounded memory.

    The speed of targets is that over 100 ms.

    Args:
        joints: number of joints.
    """

    def __init__(self, joints: int) -> None:
        self._window: deque[tuple[float, Vector, Vector]] = deque()
        """Times, errors and targets of the rows that are needed for speeds."""
        self._next = 0
        """Index in it of the first row whose speed is not known yet."""
        self._product, self._square, self._rows = np.zeros(joints), np.zeros(joints), 0

    def add(self, time_s: float, actual_rad: Vector, target_rad: Vector) -> None:
        """Take a row.

        Args:
            time_s: larger than that of the row before.
            actual_rad: measured, shape (joints,).
            target_rad: asked for, likewise; NaN for nothing.
        """
        self._window.append((time_s, actual_rad - target_rad, target_rad.copy()))
        while self._window[self._next][0] + _HALF_S <= time_s:
            self._judge_next()

    def finish(self) -> list[float | None]:
        """Return the lags, ms, after the last row; None for a joint without moving targets."""
        while self._next < len(self._window):
            self._judge_next()
        lags = _quotient(self._product, self._square, self._rows)
        return [_MS * float(each) if np.isfinite(each) else None for each in lags]

    def _judge_next(self) -> None:
        """Add the next row to the sums, with the speed from the first to the last in the window."""
        time_s, error_rad, target_rad = self._window[self._next]
        while self._window[0][0] < time_s - _HALF_S:
            self._window.popleft()
            self._next -= 1
        self._next += 1
        (start_s, _, start_rad), (end_s, _, end_rad) = self._window[0], self._window[-1]
        if end_s > start_s and np.isfinite([start_rad, target_rad, end_rad]).all():
            speed_rad_s = (end_rad - start_rad) / (end_s - start_s)
            self._product += error_rad * speed_rad_s
            self._square += speed_rad_s**2
            self._rows += 1

"""The positions that a client asks for, as the reference of its run."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bus_schema.arrays import Matrix, Vector
from controller.reference_file import KINDS, TIME

_RESTS_S = 0.05
"""A position that stays longer than this is held; others are joined to the next by a line."""
_IDLE_S = 0.02
_SAME_LINE_RAD, _THINNED_S = 1e-9, 1.0
"""Rows so near to a line are left out, but for one in this time."""
_STRAIGHT_RAD, _TURN_S = 1e-4, 2e-6
"""A motion that leaves the line between two rows by more is made straight, but for these times."""


class AskedMotion:
    """Rows at the ticks at which a client asks for another position.

    Where it asks for none, the rows are the measured motion. What it asks for beyond the range of a
    joint counts as the end of the range. Rows inside a line are left out as they arrive.

    Args:
        period_s: of the ticks.
        lower_rad: ends of the joints' ranges, shape (joints,).
        upper_rad: likewise.

    Attributes:
        first_s: when it asked for a position for the first time; None as long as it did not.
        last_s: when it asked for another one for the last time.
    """

    def __init__(self, period_s: float, lower_rad: Vector, upper_rad: Vector) -> None:
        self._period_s = period_s
        self._lower_rad, self._upper_rad = lower_rad, upper_rad
        self._times_s: list[float] = []
        self._rows: list[Vector] = []
        self._line_begin = 0
        self._follows = False
        self.first_s: float | None = None
        self.last_s: float | None = None

    def add(self, now_s: float, actual_rad: Vector, target_rad: Vector) -> None:
        """Take the positions of a tick, shape (joints,); NaN for no target."""
        is_idle = bool(np.isnan(target_rad).any())
        actual_rad = np.clip(actual_rad, self._lower_rad, self._upper_rad)
        target_rad = np.clip(target_rad, self._lower_rad, self._upper_rad)
        if is_idle and not self._follows:
            if not self._times_s or now_s - self._times_s[-1] > _IDLE_S:
                self._put(now_s, actual_rad)
            return
        if not is_idle and self._follows and (target_rad == self._rows[-1]).all():
            return
        if not is_idle:
            self.last_s = now_s
            self.first_s = now_s if self.first_s is None else self.first_s
        before_s = now_s - self._period_s
        rests_s = _RESTS_S if self._follows else 0.5 * self._period_s
        if self._times_s and before_s > self._times_s[-1] + rests_s:
            self._put(before_s, self._rows[-1] if self._follows else actual_rad)
        self._put(now_s, actual_rad if is_idle else target_rad)
        self._follows = not is_idle

    def write(self, file: Path, names: tuple[str, ...]) -> None:
        """Write a reference file, with speeds that pass no row's position between two rows."""
        times_s, rows = np.array(self._times_s), np.array(self._rows)
        times_s, rows, slopes = straightened(times_s, rows, monotone_slopes(times_s, rows))
        motion = np.stack([rows, slopes, np.zeros_like(rows)], axis=2)
        heads = [TIME, *(f"{name}.{kind}" for name in names for kind in KINDS)]
        table = np.column_stack([times_s, motion.reshape(len(times_s), -1)])
        np.savetxt(file, table, "%.12g", ",", header=",".join(heads), comments="")

    def _put(self, now_s: float, row: Vector) -> None:
        goes_on = self._is_on_line(now_s, row)
        self._times_s.append(now_s)
        self._rows.append(row.copy())
        if not goes_on:
            self._line_begin = max(len(self._rows) - 2, 0)
            return
        # Two rows at each end of a line keep its speed there.
        is_inside = len(self._rows) - 3 > self._line_begin + 1
        if is_inside and self._times_s[-2] - self._times_s[-4] <= _THINNED_S:
            del self._times_s[-3], self._rows[-3]

    def _is_on_line(self, now_s: float, row: Vector) -> bool:
        """Return whether a row goes on with the line through the first two rows of the last one."""
        first, second = self._line_begin, self._line_begin + 1
        if second >= len(self._rows):
            return False
        begin_s, begin = self._times_s[first], self._rows[first]
        share = (now_s - begin_s) / (self._times_s[second] - begin_s)
        away = np.abs(begin + share * (self._rows[second] - begin) - row)
        return bool((away <= _SAME_LINE_RAD).all())


def monotone_slopes(times_s: Vector, rows: Matrix) -> Matrix:
    """Return slopes of a monotone interpolation (Fritsch and Butland), 0 at both ends.

    Args:
        times_s: increasing, shape (rows,).
        rows: values, shape (rows, columns).
    """
    slopes = np.zeros_like(rows)
    if len(rows) > 2:
        steps = np.diff(rows, axis=0) / np.diff(times_s)[:, None]
        product, total = steps[:-1] * steps[1:], steps[:-1] + steps[1:]
        same = product > 0.0
        slopes[1:-1][same] = 2.0 * product[same] / total[same]
    return slopes


def straightened(times_s: Vector, rows: Matrix, slopes: Matrix) -> tuple[Vector, Matrix, Matrix]:
    """Return times, rows and slopes with rows that make jumps between two rows straight.

    A client can jump. Between two ticks, a smooth jump would leave the line that all ticks show.

    Args:
        times_s: increasing, shape (rows,).
        rows: positions, shape (rows, joints).
        slopes: their velocities.
    """
    lasts_s, steps = np.diff(times_s)[:, None], np.diff(rows, axis=0)
    # A cubic through both rows leaves their line the most near its middle.
    away = 0.125 * lasts_s * (slopes[:-1] - slopes[1:])
    quarters = 0.1 * np.abs(lasts_s * (slopes[:-1] + slopes[1:]) - 2.0 * steps)
    jumps = np.flatnonzero(((np.abs(away) + quarters) > _STRAIGHT_RAD).any(axis=1))
    speeds = steps[jumps] / lasts_s[jumps]
    inner_s = np.concatenate([times_s[jumps] + _TURN_S, times_s[jumps + 1] - _TURN_S])
    all_s = np.concatenate([times_s, inner_s])
    order = np.argsort(all_s, kind="stable")
    positions = np.concatenate(
        [rows, rows[jumps] + _TURN_S * speeds, rows[jumps + 1] - _TURN_S * speeds]
    )
    return all_s[order], positions[order], np.concatenate([slopes, speeds, speeds])[order]

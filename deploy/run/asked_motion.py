"""The positions that a client asks for, as the reference of its run."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bus_schema.arrays import Matrix, Vector
from controller.reference_file import KINDS, TIME

_RESTS_S = 0.05
"""A position that stays longer than this is held; others are joined to the next by a line."""
_IDLE_S = 0.02


class AskedMotion:
    """Rows at the ticks at which a client asks for another position.

    Where it asks for none, the rows are the measured motion.

    Args:
        period_s: of the ticks.
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._times_s: list[float] = []
        self._rows: list[Vector] = []
        self._follows = False

    def add(self, now_s: float, actual_rad: Vector, target_rad: Vector) -> None:
        """Take the positions of a tick, shape (joints,); NaN for no target."""
        is_idle = bool(np.isnan(target_rad).any())
        if is_idle and not self._follows:
            if not self._times_s or now_s - self._times_s[-1] > _IDLE_S:
                self._put(now_s, actual_rad)
            return
        if not is_idle and self._follows and (target_rad == self._rows[-1]).all():
            return
        before_s = now_s - self._period_s
        if self._times_s and before_s > self._times_s[-1] + _RESTS_S * self._follows:
            self._put(before_s, self._rows[-1] if self._follows else actual_rad)
        self._put(now_s, actual_rad if is_idle else target_rad)
        self._follows = not is_idle

    def write(self, file: Path, names: tuple[str, ...]) -> None:
        """Write a reference file, with speeds that pass no row's position between two rows."""
        times_s, rows = np.array(self._times_s), np.array(self._rows)
        motion = np.stack([rows, monotone_slopes(times_s, rows), np.zeros_like(rows)], axis=2)
        heads = [TIME, *(f"{name}.{kind}" for name in names for kind in KINDS)]
        table = np.column_stack([times_s, motion.reshape(len(times_s), -1)])
        np.savetxt(file, table, "%.9g", ",", header=",".join(heads), comments="")

    def _put(self, now_s: float, row: Vector) -> None:
        self._times_s.append(now_s)
        self._rows.append(row.copy())


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

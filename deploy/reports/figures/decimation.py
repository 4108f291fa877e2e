"""Fewer points for the same picture: long series thinned without losing an extreme."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Vector

MAX_POINTS = 4000

_Indices = NDArray[np.int64]


def decimate(x: Vector, y: Vector, max_points: int = MAX_POINTS) -> tuple[Vector, Vector]:
    """The smallest and the largest y of each of max_points / 2 equally long stretches, in order.

    A series of at most `max_points` comes back as it is. NaN is passed over, unless a stretch has
    nothing else.

    Args:
        x: shape (points,).
        y: shape (points,).
        max_points: at least 2.
    """
    if len(y) <= max_points:
        return x, y
    edges = np.linspace(0, len(y), max_points // 2 + 1).astype(np.int64)
    starts, ends = edges[:-1], edges[1:]
    lowest = _first_in_each_stretch(np.where(np.isnan(y), np.inf, y), starts, ends, np.minimum)
    highest = _first_in_each_stretch(np.where(np.isnan(y), -np.inf, y), starts, ends, np.maximum)
    kept = np.union1d(lowest, highest)
    return x[kept], y[kept]


def _first_in_each_stretch(
    y: Vector, starts: _Indices, ends: _Indices, extreme: np.ufunc
) -> _Indices:
    """Indices at which each stretch first takes its extreme value."""
    hits = y == np.repeat(extreme.reduceat(y, starts), ends - starts)
    positions: _Indices = np.flatnonzero(hits)
    return positions[np.searchsorted(positions, starts)]

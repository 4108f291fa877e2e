"""Array types shared by every room, tables with named columns, and percentiles."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

Vector: TypeAlias = NDArray[np.float64]
"""One value per joint, shape (joints,)."""

Matrix: TypeAlias = NDArray[np.float64]
"""Two axes of float64."""

Records: TypeAlias = NDArray[np.void]
"""Rows with named fields, which compiled code reads as ``records[i].name``."""


def elementwise(function: Callable[[float], float], values: Vector) -> Vector:
    """Apply a function of Python's `math` to values, same bits on every CPU; shape (values,).

    NumPy's own exp, log, tanh, arctan2 and powers differ in their last bits on CPUs with AVX-512.
    """
    return np.array([function(value) for value in values.tolist()], dtype=np.float64)


def records(rows: int, columns: Mapping[str, ArrayLike]) -> Records:
    """Build a table from columns, each with one value per row or one for all; shape (rows,)."""
    kinds = [(name, np.asarray(values).dtype) for name, values in columns.items()]
    table = np.zeros(rows, np.dtype(kinds, align=True))
    for name, values in columns.items():
        table[name] = values
    return table


PERCENTILES = {"p50": 0.50, "p99": 0.99, "p99_9": 0.999, "max": 1.0}
"""Percentiles of times in ``summary.json``, with their shares."""


def percentiles(values: NDArray[Any], counts: NDArray[Any] | None = None) -> dict[str, Any]:
    """Return exact percentiles, each a value that occurred; null where there are no values.

    Args:
        values: shape (values,).
        counts: how often each value occurred; once by default.
    """
    if not (values.size if counts is None else counts.any()):
        return dict.fromkeys(PERCENTILES)
    shares = list(PERCENTILES.values())
    found = np.quantile(values, shares, weights=counts, method="inverted_cdf")
    return dict(zip(PERCENTILES, np.asarray(found, dtype=np.float64).tolist(), strict=True))

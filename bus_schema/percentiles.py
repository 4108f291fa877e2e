"""Percentiles of times for ``summary.json``."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

PERCENTILES = {"p50": 0.50, "p99": 0.99, "p99_9": 0.999, "max": 1.0}


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

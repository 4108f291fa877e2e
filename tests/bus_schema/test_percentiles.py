"""Percentiles are values that occurred, counted or listed."""

from __future__ import annotations

import numpy as np

from bus_schema.arrays import percentiles


def test_percentiles_are_values_that_occurred() -> None:
    thousand = np.random.default_rng(1).permutation(np.arange(1, 1001))
    assert percentiles(thousand) == {"p50": 500.0, "p99": 990.0, "p99_9": 999.0, "max": 1000.0}
    assert percentiles(np.array([7.5])) == {"p50": 7.5, "p99": 7.5, "p99_9": 7.5, "max": 7.5}
    assert set(percentiles(np.array([], dtype=np.int64)).values()) == {None}


def test_counted_values_have_the_percentiles_of_listed_ones() -> None:
    values = np.random.default_rng(2).integers(0, 40, 997)
    counted, counts = np.unique(values, return_counts=True)
    order = np.random.default_rng(3).permutation(len(counted))
    assert percentiles(counted[order], counts[order]) == percentiles(values)

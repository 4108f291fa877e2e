"""A fast check for finite numbers."""

from __future__ import annotations

import math

from bus_schema.arrays import Vector
from bus_schema.compiled import compiled


@compiled
def all_finite(values: Vector) -> bool:
    """Whether no entry of a one-dimensional array is infinite or NaN."""
    for value in values:  # noqa: SIM110 (compiled: a loop is the fast form)
        if not math.isfinite(value):
            return False
    return True

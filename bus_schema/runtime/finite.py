"""A fast check for finite numbers."""

from __future__ import annotations

import math

from bus_schema.arrays import Matrix, Vector
from bus_schema.runtime.compiled import compiled


@compiled
def all_finite(values: Vector | Matrix) -> bool:
    """Whether no entry of an array is infinite or NaN."""
    for value in values.flat:  # noqa: SIM110 (compiled: a loop is the fast form)
        if not math.isfinite(value):
            return False
    return True

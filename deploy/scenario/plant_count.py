"""Counter in the plant of the ticks at which its arm is outside the funnel."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from bus_schema.arrays import Vector
from controller.funnel import Funnel
from controller.reference import Reference

_SECOND_NS = 1_000_000_000


class FunnelCounter:
    """Counter of the ticks at which the arm was outside its funnel.

    Args:
        reference: the arm's reference.
        funnel: the bounds.
        position: true joint positions, rad, shape (joints,), read at each `look`.
    """

    def __init__(self, reference: Reference, funnel: Funnel, position: Vector) -> None:
        wanted, *rates = np.empty((3, len(position)))
        self._counts = np.zeros(3)
        self._follow = reference.onto(wanted, *rates)
        self._compare = funnel.counting(position, wanted, self._counts)

    def look(self, stamp_ns: int) -> bool:
        """Count the tick at this instant; return whether any tick so far was outside."""
        seconds, rest_ns = divmod(stamp_ns, _SECOND_NS)
        time_s = seconds + 1e-9 * rest_ns  # computed as readers of stamps do, to the bit
        self._follow(time_s)
        self._compare(time_s)
        return bool(self._counts[1])

    def counts(self) -> dict[str, Any]:
        """Return the number of ``ticks``, those ``outside`` the funnel, and the smallest margin."""
        ticks, outside, largest = self._counts.tolist()
        margin = 1.0 - largest if math.isfinite(largest) else None
        return {"ticks": int(ticks), "outside": int(outside), "margin_min": margin}

"""The plant's own count of its true error against the scenario's funnel, whatever is recorded."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from bus_schema.arrays import Vector
from controller.funnel import Funnel
from controller.reference import Reference

_SECOND_NS = 1_000_000_000


class TruthWatch:
    """Counts the ticks at which the arm was outside its funnel.

    Args:
        reference: what the arm is to follow.
        funnel: the bounds.
        position: true joint positions, rad, shape (joints,), as they are at each look.
    """

    def __init__(self, reference: Reference, funnel: Funnel, position: Vector) -> None:
        wanted, *rates = np.empty((3, len(position)))
        self._counts = np.zeros(3)
        self._follow = reference.onto(wanted, *rates)
        self._compare = funnel.counting(position, wanted, self._counts)

    def look(self, stamp_ns: int) -> None:
        """Count a tick, by its instant."""
        seconds, rest_ns = divmod(stamp_ns, _SECOND_NS)
        time_s = seconds + 1e-9 * rest_ns  # as readers of stamps work it out, to the bit
        self._follow(time_s)
        self._compare(time_s)

    def counts(self) -> dict[str, Any]:
        """``ticks`` looked at, those ``outside`` the funnel, and the smallest margin of all."""
        ticks, outside, largest = self._counts.tolist()
        margin = 1.0 - largest if math.isfinite(largest) else None
        return {"ticks": int(ticks), "outside": int(outside), "margin_min": margin}

"""The funnel as a law works with it: it opens again around an error that has got out.

The paper assumes that the error never leaves. Behind a network it does, in a gap between commands,
and then the transformation has no value, and close to its end the surface hardly pulls back. So the
working funnel opens around such an error as the real one does around an error at the start, and
closes at a rate of its own, after which both are the same again. Ours; whether a run *kept* its
bounds is judged by the real funnel alone.
"""

from __future__ import annotations

import math

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.runtime.compiled import compiled
from controller.control_law import D_LOWER, D_UPPER, DD_LOWER, DD_UPPER, LOWER, UPPER

LARGEST_SHARE = 0.98
"""Share of a bound at which the funnel opens: a little later, the logarithm ends."""
OPENING = 1.5
"""The new bound over the error, so that the error uses two thirds of it."""
RATE_PER_S = 4.0


class WorkingFunnel:
    """What `reopen` keeps from cycle to cycle.

    Attributes:
        bounds: as `Tracking.bounds`, and equal to them unless an error has got out of them.
        opening: by how much they are wider, rad, shape (joints,).
    """

    def __init__(self, joints: int) -> None:
        self.bounds: Matrix = np.zeros((6, joints))
        self.opening: Vector = np.zeros(joints)

    def reset(self) -> None:
        """Forget that an error ever got out."""
        self.opening[:] = 0.0


@compiled
def reopen(error: Vector, bounds: Matrix, step_s: float, opening: Vector, working: Matrix) -> None:
    """Work out bounds in which every error has its place; for use in a law's own kernel.

    Args:
        error: rad, shape (joints,).
        bounds: `Tracking.bounds`.
        step_s: time since the last call.
        opening: that of a `WorkingFunnel`, brought up to date.
        working: `bounds` of the same, brought up to date.
    """
    decay = math.exp(-RATE_PER_S * step_s)
    for i in range(error.size):
        opening[i] *= decay
        bound = bounds[UPPER, i] if error[i] > 0.0 else bounds[LOWER, i]
        if abs(error[i]) > LARGEST_SHARE * (bound + opening[i]):
            opening[i] = OPENING * abs(error[i]) - bound
        working[UPPER, i] = bounds[UPPER, i] + opening[i]
        working[LOWER, i] = bounds[LOWER, i] + opening[i]
        working[D_UPPER, i] = bounds[D_UPPER, i] - RATE_PER_S * opening[i]
        working[D_LOWER, i] = bounds[D_LOWER, i] - RATE_PER_S * opening[i]
        working[DD_UPPER, i] = bounds[DD_UPPER, i] + RATE_PER_S**2 * opening[i]
        working[DD_LOWER, i] = bounds[DD_LOWER, i] + RATE_PER_S**2 * opening[i]

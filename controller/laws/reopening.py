"""The funnel as a law works with it: it opens again around an error that has got out.

The paper assumes that the error never leaves. Behind a network it does, in a gap between commands,
and then the transformation has no value, and close to its end the surface hardly pulls back. So the
working funnel opens around such an error as the real one does around an error at the start, and
closes at a rate of its own, after which both are the same again. Ours; whether a run *kept* its
bounds is judged by the real funnel alone.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.runtime.compiled import compiled
from controller.control_law import D_LOWER, D_UPPER, DD_LOWER, DD_UPPER, LOWER, UPPER

LARGEST_SHARE = 0.98
"""Share of a bound at which the funnel opens: a little later, the logarithm ends."""
OPENING = 1.5
"""The new bound over the error, so that the error uses two thirds of it."""
RATE_PER_S = 4.0


class WorkingFunnel(NamedTuple):
    """What `reopen` keeps from cycle to cycle, in arrays that it changes in place.

    Attributes:
        bounds: as `Tracking.bounds`, and equal to them unless an error has got out of them.
        opening: by how much they are wider, rad, shape (joints,).
    """

    bounds: Matrix
    opening: Vector

    @classmethod
    def of(cls, joints: int) -> WorkingFunnel:
        """One for an error that has never got out."""
        return cls(np.zeros((6, joints)), np.zeros(joints))

    def reset(self) -> None:
        """Forget that an error ever got out."""
        self.opening[:] = 0.0


@compiled
def reopen(error: Vector, real_bounds: Matrix, step_s: float, funnel: WorkingFunnel) -> None:
    """Bring a working funnel up to date, so that every error has its place in it.

    Args:
        error: rad, shape (joints,).
        real_bounds: `Tracking.bounds`.
        step_s: time since the last call.
        funnel: changed in place.
    """
    bounds, opening = funnel
    decay = math.exp(-RATE_PER_S * step_s)
    for i in range(error.size):
        opening[i] *= decay
        bound = real_bounds[UPPER, i] if error[i] > 0.0 else real_bounds[LOWER, i]
        if abs(error[i]) > LARGEST_SHARE * (bound + opening[i]):
            opening[i] = OPENING * abs(error[i]) - bound
        bounds[UPPER, i] = real_bounds[UPPER, i] + opening[i]
        bounds[LOWER, i] = real_bounds[LOWER, i] + opening[i]
        bounds[D_UPPER, i] = real_bounds[D_UPPER, i] - RATE_PER_S * opening[i]
        bounds[D_LOWER, i] = real_bounds[D_LOWER, i] - RATE_PER_S * opening[i]
        bounds[DD_UPPER, i] = real_bounds[DD_UPPER, i] + RATE_PER_S**2 * opening[i]
        bounds[DD_LOWER, i] = real_bounds[DD_LOWER, i] + RATE_PER_S**2 * opening[i]

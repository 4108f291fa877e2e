"""The working funnel of a law, which opens again around an error that has left it.

The paper assumes that the error never leaves. Over a network it does, in a gap between commands:
the transformation is then undefined, and near its end the surface hardly pulls back. So the working
funnel opens around such an error as the real one does at the start, and closes at a separate rate
until both are equal again. This part is ours; only the real funnel decides whether a run *kept* its
bounds.
"""

from __future__ import annotations

import math

from bus_schema.arrays import Vector
from bus_schema.runtime.compiled import compiled
from controller.control_law import D_LOWER, D_UPPER, DD_LOWER, DD_UPPER, LOWER, UPPER
from controller.funnel import Bound

LARGEST_SHARE = 0.98
"""Share of a bound at which the funnel opens, just before the logarithm diverges."""
OPENING = 1.5
"""New bound divided by the error, so that the error uses two thirds of it."""
RATE_PER_S = 4.0


@compiled
def working_bounds(
    error: float, bounds: Vector, step_s: float, opening: float
) -> tuple[Bound, Bound, float]:
    """Return the upper and lower working bound of a joint.

    Args:
        error: rad.
        bounds: the joint's column of `Tracking.bounds`.
        step_s: time since the last call.
        opening: how much wider the working funnel was than the real one at the last call, rad.

    Returns:
        The bounds, and how much wider they are now; zero if no error has left.
    """
    opening *= math.exp(-RATE_PER_S * step_s)
    bound = bounds[UPPER] if error > 0.0 else bounds[LOWER]
    if abs(error) > LARGEST_SHARE * (bound + opening):
        opening = OPENING * abs(error) - bound
    d_opening, dd_opening = RATE_PER_S * opening, RATE_PER_S**2 * opening
    upper = bounds[UPPER] + opening, bounds[D_UPPER] - d_opening, bounds[DD_UPPER] + dd_opening
    lower = bounds[LOWER] + opening, bounds[D_LOWER] - d_opening, bounds[DD_LOWER] + dd_opening
    return upper, lower, opening

"""The funnel as a law works with it: it opens again around an error that has got out.

The paper assumes that the error never leaves. Behind a network it does, in a gap between commands,
and then the transformation has no value, and close to its end the surface hardly pulls back. So the
working funnel opens around such an error as the real one does around an error at the start, and
closes at a rate of its own, after which both are the same again. Ours; whether a run *kept* its
bounds is judged by the real funnel alone.
"""

from __future__ import annotations

import math

from bus_schema.arrays import Vector
from bus_schema.runtime.compiled import compiled
from controller.control_law import D_LOWER, D_UPPER, DD_LOWER, DD_UPPER, LOWER, UPPER
from controller.funnel import Bound

LARGEST_SHARE = 0.98
"""Share of a bound at which the funnel opens: a little later, the logarithm ends."""
OPENING = 1.5
"""The new bound over the error, so that the error uses two thirds of it."""
RATE_PER_S = 4.0


@compiled
def working_bounds(
    error: float, bounds: Vector, step_s: float, opening: float
) -> tuple[Bound, Bound, float]:
    """Upper and lower bound of a joint between which its error has its place.

    Args:
        error: rad.
        bounds: the joint's column of `Tracking.bounds`.
        step_s: time since the last call.
        opening: by how much the working funnel was wider than the real one at the last call, rad.

    Returns:
        The bounds, and by how much they are wider now; unless an error has got out, by nothing.
    """
    opening *= math.exp(-RATE_PER_S * step_s)
    bound = bounds[UPPER] if error > 0.0 else bounds[LOWER]
    if abs(error) > LARGEST_SHARE * (bound + opening):
        opening = OPENING * abs(error) - bound
    d_opening, dd_opening = RATE_PER_S * opening, RATE_PER_S**2 * opening
    upper = bounds[UPPER] + opening, bounds[D_UPPER] - d_opening, bounds[DD_UPPER] + dd_opening
    lower = bounds[LOWER] + opening, bounds[D_LOWER] - d_opening, bounds[DD_LOWER] + dd_opening
    return upper, lower, opening

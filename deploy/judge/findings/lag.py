"""A lag: the arm moves as its reference did a constant time before, as after a transport delay."""

from __future__ import annotations

import numpy as np

from bus_schema.arrays import Vector

_EXPLAINED = 0.95
"""Share of the error's square; other smooth errors have it only with lags longer than they last."""
_LEFT_AT_END = 0.3
"""Share of the last error, which left the bounds."""
_TIMES_ITS_LENGTH = 2.0
"""A lag shows only in a longer time."""


def lag_s(
    errors_rad: Vector, wanted_rad: Vector, period_s: float, known_s: float = 0.0
) -> float | None:
    """Return the time T of e(t) = q_d(t − T) − q_d(t), s; None if that is not what the error is.

    At a constant speed v of the reference, that is e = −T v, the error of any follower that is T
    behind. As the arm starts, a joint that is still at rest has the same error as a slow one.

    Args:
        errors_rad: of a joint at its last ticks, shape (ticks,).
        wanted_rad: its reference at these ticks and all before them; it rests until the first.
        period_s: of a tick.
        known_s: a lag that the arm may have, also if these ticks last less than twice as long.
    """
    ticks, size = len(errors_rad), float((errors_rad**2).sum())
    known = np.concatenate([np.full(ticks, wanted_rad[0]), wanted_rad])
    now, speeds = known[-ticks:], np.gradient(known, period_s)

    def left(late: int) -> Vector:
        return np.asarray(errors_rad - (known[len(known) - ticks - late :][:ticks] - now))

    tried = range(min(ticks, max(int(ticks / _TIMES_ITS_LENGTH), round(known_s / period_s))) + 1)
    late = min(tried, key=lambda each: float((left(each) ** 2).sum()))
    speed = speeds[len(known) - ticks - late :][:ticks]
    square = float((speed**2).sum())
    # What is left of a tick changes the error by its share of the speed.
    part_s = -float((left(late) * speed).sum()) / square if square > 0.0 else 0.0
    part_s = min(max(part_s, -0.5 * period_s), 0.5 * period_s)
    rest, lag = left(late) + part_s * speed, late * period_s + part_s
    is_explained = size > 0.0 and float((rest**2).sum()) <= (1.0 - _EXPLAINED) * size
    is_at_end = abs(rest[-1]) <= _LEFT_AT_END * abs(errors_rad[-1])
    return lag if is_explained and is_at_end and lag > 0.0 and late < tried[-1] else None

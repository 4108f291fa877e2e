"""Finds and removes the drift between the clock that stamps messages and the one that logs them.

No message arrives before it is sent, so the smallest delays lie on one level. Clocks of different
rates tilt that level. Its slope is that of the line below all delays with the least mean distance
(Moon, Skelly and Towsley, "Estimation and removal of clock skew from network delay measurements",
1999).
"""

from __future__ import annotations

import numpy as np

from bus_schema.arrays import Vector
from deploy.judge.findings.link_delays import MeasuredDelays

MOST_PPM = 500.0
"""Quartz clocks differ by at most 200, and a time service slews them by at most 500."""
_WINDOWS, _FEWEST, _FEWEST_WINDOWS = 20, 20, 5
_LEAST_MS, _CLEARLY = 0.1, 3.0
"""A drift is at least this large in all, and as many times as large as what a line leaves."""
_MOVES_MS = 1.0
_FARTHEST_MS = 10_000.0
_STEPS, _SHRINK = 80, 0.5 * (5**0.5 - 1.0)


def drift_ppm(measured: MeasuredDelays) -> float:
    """Return by how much the receiving clock is faster than the sending one; 0 for no drift.

    Raises:
        ValueError: the smallest delays move, but not as clocks drift; the message says how.
    """
    arrived = np.isfinite(measured.delays_ms)
    times_s, delays_ms = measured.sent_s[arrived], measured.delays_ms[arrived]
    windows = min(_WINDOWS, len(times_s) // _FEWEST)
    if windows < _FEWEST_WINDOWS or not np.ptp(times_s) > 0.0:
        return 0.0
    slope, duration_s = _envelope_slope(times_s, delays_ms), float(np.ptp(times_s))
    moves_ms = abs(slope) * duration_s
    if moves_ms > max(_LEAST_MS, _CLEARLY * _movement(delays_ms - slope * times_s, windows)):
        if abs(slope) > MOST_PPM / 1e3:
            raise ValueError(
                f"the smallest delays change by {slope:.4g} ms every second, and clocks drift by"
                f" at most {MOST_PPM / 1e3:g}: one clock shows simulated time, or a queue grows"
            )
        return slope * 1e3
    moves_ms, spread_ms = _movement(delays_ms, windows), _spread(delays_ms, windows)
    if moves_ms > max(_MOVES_MS, spread_ms):
        raise ValueError(
            f"the smallest delays move by {moves_ms:.3g} ms in {duration_s:.4g} s, and not on a"
            " line: the clocks were set in between, or the network changed"
        )
    return 0.0


def without_drift(measured: MeasuredDelays, ppm: float) -> MeasuredDelays:
    """Return delays as if the receiving clock had the rate of the sending one."""
    delays_ms = measured.delays_ms - 1e-3 * ppm * (measured.sent_s - measured.sent_s[0])
    return measured._replace(delays_ms=delays_ms)


def at_least(measured: MeasuredDelays, least_ms: float | None) -> MeasuredDelays:
    """Return delays whose smallest one is as given; None: as they are.

    Raises:
        ValueError: none is given, and the clocks differ by far more than messages take.
    """
    if measured.lost == len(measured.delays_ms):
        return measured
    found_ms = float(np.nanmin(measured.delays_ms))
    if least_ms is not None:
        return measured._replace(delays_ms=measured.delays_ms + (least_ms - found_ms))
    if abs(found_ms) > _FARTHEST_MS:
        raise ValueError(
            f"messages are received {found_ms / 1e3:.4g} s after they are sent, or later: these are"
            " two clocks, as of simulated time and of the day. If they run at one rate, give the"
            " true smallest delay with --least MS"
        )
    return measured


def _envelope_slope(times_s: Vector, delays_ms: Vector) -> float:
    """Return the slope of the line below all delays with the least mean distance, ms/s."""
    middle_s = times_s.mean()

    def distance(slope: float) -> float:  # but for the mean of delays; convex
        return -slope * float(middle_s) - float((delays_ms - slope * times_s).min())

    high = 2.0 * float(np.ptp(delays_ms)) / float(np.ptp(times_s))
    low = -high
    for _ in range(_STEPS):  # golden section
        inner = (high - low) * _SHRINK
        if distance(high - inner) < distance(low + inner):
            high = low + inner
        else:
            low = high - inner
    return 0.5 * (low + high)


def _movement(delays_ms: Vector, windows: int) -> float:
    """Return how far the smallest delays of windows are apart, ms."""
    return float(np.ptp([each.min() for each in np.array_split(delays_ms, windows)]))


def _spread(delays_ms: Vector, windows: int) -> float:
    """Return how far a usual delay is above the smallest of its window, ms."""
    parts = np.array_split(delays_ms, windows)
    return float(np.median([np.median(each) - each.min() for each in parts]))

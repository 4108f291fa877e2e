"""Delays that vary in a pattern: a function of the run's time alone, between two limits."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from bus_schema.link.channel_configuration import PatternConfiguration


def delay_in_pattern_ns(pattern: PatternConfiguration, largest_ns: float, now_ns: int) -> float:
    """Return the delay of a message that is sent at an instant, ns.

    Args:
        pattern: the section ``pattern`` of a direction.
        largest_ns: the largest delay of the pattern.
        now_ns: time of the run.
    """
    least_ns = min(1e6 * pattern.least_ms, largest_ns)
    return least_ns + share_in_pattern(pattern, now_ns) * (largest_ns - least_ns)


def share_in_pattern(pattern: PatternConfiguration, now_ns: int) -> float:
    """Return where the delay is at an instant: 0 for the smallest, 1 for the largest."""
    period_ns = round(1e6 * pattern.period_ms)
    period, into_ns = divmod(now_ns + round(1e6 * pattern.phase_ms), period_ns)
    share = into_ns / period_ns
    match pattern.shape:
        case "square":
            return float(share >= 1.0 - pattern.duty)
        case "sawtooth":
            return share
        case "falling":
            return 1.0 - share
        case "random":
            return _random(pattern.seed, period)
        case "walk":
            start, end = _random(pattern.seed, period), _random(pattern.seed, period + 1)
            return start + share * (end - start)


@lru_cache(maxsize=16)  # most messages ask for the period of the message before them
def _random(seed: int, period: int) -> float:
    """Return a number between 0 and 1 that belongs to this period; the others do not matter."""
    return float(np.random.default_rng((seed, period)).random())

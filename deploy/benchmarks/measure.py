"""Interleaved repetitions: whatever the machine does meanwhile, it does to all candidates alike."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Measurement:
    """Repeated measurements of one quantity.

    Attributes:
        median_us: median over the repetitions.
        lowest_us: lowest of them.
        highest_us: highest of them.
    """

    median_us: float
    lowest_us: float
    highest_us: float


def interleave(
    candidates: Mapping[str, Callable[[], float]], repetitions: int
) -> dict[str, Measurement]:
    """Measure all candidates in turn, again and again.

    Args:
        candidates: by name, a function that returns a cost in µs.
        repetitions: how often each is called, after one call that does not count.
    """
    samples: dict[str, list[float]] = {name: [] for name in candidates}
    for repetition in range(repetitions + 1):
        for name, measure in candidates.items():
            cost_us = measure()
            if repetition:
                samples[name].append(cost_us)
    return {
        name: Measurement(float(np.median(costs)), min(costs), max(costs))
        for name, costs in samples.items()
    }

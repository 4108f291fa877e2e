"""Interleaved repetitions: the machine's load affects all candidates equally."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from deploy.run.stop_signals import end_if_asked


@dataclass(frozen=True)
class Spread:
    """Repeated measurements of one quantity: a cost in µs, or a ratio.

    Attributes:
        samples: one value per repetition.
    """

    samples: tuple[float, ...]

    @property
    def median(self) -> float:
        return float(np.median(self.samples))

    @property
    def lowest(self) -> float:
        return min(self.samples)

    @property
    def highest(self) -> float:
        return max(self.samples)

    def as_dict(self) -> dict[str, float]:
        return {"median": self.median, "lowest": self.lowest, "highest": self.highest}


Costs = dict[str, Spread]
"""Costs in µs by name, all measured in the same repetitions."""


@dataclass(frozen=True)
class Ratio:
    """A ratio of costs, computed in each repetition.

    Attributes:
        over: names of the costs in the numerator, summed.
        under: names of the costs in the denominator, summed.
    """

    over: tuple[str, ...]
    under: tuple[str, ...]
    value: Spread

    @property
    def name(self) -> str:
        return f"{' + '.join(self.over)} / {' + '.join(self.under)}"


@dataclass(frozen=True)
class Section:
    """Costs measured side by side.

    Attributes:
        title: its title.
        costs_us: all costs.
        ratios: the ratios to report.
        notes: missing parts with reasons, and notes for the reader.
    """

    title: str
    costs_us: Costs
    ratios: list[Ratio]
    notes: list[str] = field(default_factory=list)

    def as_dict(self) -> dict[str, Any]:
        return {
            "costs_us": {name: cost.as_dict() for name, cost in self.costs_us.items()},
            "ratios": {ratio.name: ratio.value.as_dict() for ratio in self.ratios},
            "notes": self.notes,
        }


def interleave(
    candidates: Mapping[str, Callable[[], float | Mapping[str, float]]], repetitions: int
) -> Costs:
    """Measure all candidates in turn, repeatedly.

    Args:
        candidates: by name, a function that returns a cost in µs, or several costs by their names.
        repetitions: how often each is called, after one call that does not count.

    Raises:
        Stopped: a stop was requested where Python ignores exceptions of a handler.
    """
    samples: defaultdict[str, list[float]] = defaultdict(list)
    for repetition in range(repetitions + 1):
        for name, measure in candidates.items():
            end_if_asked()
            found = measure()
            costs = found if isinstance(found, Mapping) else {name: found}
            for each, cost_us in costs.items() if repetition else ():
                samples[each].append(cost_us)
    return {name: Spread(tuple(values)) for name, values in samples.items()}


def ratio(costs: Costs, over: str | Sequence[str], under: str | Sequence[str]) -> Ratio:
    """Return the ratio of two sums of costs, repetition by repetition."""
    above, below = ((names,) if isinstance(names, str) else tuple(names) for names in (over, under))
    sums = (np.sum([costs[name].samples for name in names], axis=0) for names in (above, below))
    numerator, denominator = sums
    return Ratio(above, below, Spread(tuple((numerator / denominator).tolist())))


def cost_us(
    action: Callable[[], object], times: int, clock_ns: Callable[[], int] = time.perf_counter_ns
) -> float:
    """Return the mean cost of an action, in µs.

    Args:
        action: what to do.
        times: how often.
        clock_ns: a monotonic clock.
    """
    started_ns = clock_ns()
    for _ in range(times):
        action()
    return (clock_ns() - started_ns) / times * 1e-3

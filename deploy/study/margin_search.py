"""The search for the value of a quantity at which a law loses its bounds."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from typing import Any

from deploy.judge.run_rows import Row
from deploy.study.plants import Variant

_BEYOND = (1.5, 2.0)
PARTS = 8


@dataclass(frozen=True)
class Steps:
    """Values of a search, in whole steps from the first one.

    Attributes:
        origin: the value without any change to the loop.
        resolution: size of a step.
        first: number of steps from the origin to the first probe.
        limit: number of steps.
        growth: 1 where values grow, −1 where they shrink.
    """

    origin: float
    resolution: float
    first: int
    limit: int
    growth: int = 1

    def value(self, steps: int) -> float:
        return round(self.origin + self.growth * steps * self.resolution, 9)


@dataclass
class MarginSearch:
    """Search that selects the next value to probe, in whole steps of the resolution.

    After zero come the values at which theory expects the first loss. Then values are doubled until
    one fails; the interval between the last that held and the first that failed is halved until
    they are neighbours. Where theory knows nothing, gaps between the values that held are halved
    until none is wider than a part of the margin: a loop can be unstable in a window of delays.
    Finally two larger values are probed, as bounds may be kept again beyond a failure.

    Attributes:
        steps: the values that can be probed.
        outcomes: whether each probed value held.
        rows: rows of its runs, by the probed value in steps.
        variants: starts, or patterns from all starts, to run at each value.
        requested: number of variants that were requested, by the probed value in steps.
        hints: values to probe after zero, in this order.
        parts: largest number of parts of the margin that a gap is as wide as; 1 for any width.
    """

    steps: Steps
    outcomes: dict[int, bool] = field(default_factory=dict)
    rows: dict[int, list[Row]] = field(default_factory=dict)
    variants: list[Variant] = field(default_factory=list)
    requested: dict[int, int] = field(default_factory=dict)
    hints: list[int] = field(default_factory=list)
    parts: int = PARTS

    @property
    def first_failure(self) -> int | None:
        """Smallest value that failed."""
        return min((value for value, held in self.outcomes.items() if not held), default=None)

    @property
    def margin(self) -> int | None:
        """Largest value up to which all probes held; None if zero failed."""
        failure = self.first_failure
        holding = (value for value, held in self.outcomes.items() if held)
        return max((v for v in holding if failure is None or v < failure), default=None)

    @property
    def held_again(self) -> list[int]:
        """Values beyond the first failure that held."""
        failure = self.first_failure
        if failure is None:
            return []
        return sorted(value for value, held in self.outcomes.items() if held and value > failure)

    def value(self, steps: int | None) -> float | None:
        """Return a value in the quantity's unit; None for none."""
        return None if steps is None else self.steps.value(steps)

    def ends(self) -> dict[str, Any]:
        """Return the margin and the first failure, for a summary."""
        return {
            "margin": self.value(self.margin),
            "first_failure": self.value(self.first_failure),
            "growth": self.steps.growth,
            "completed": self.next() is None,
        }

    @property
    def widest_gap(self) -> tuple[int, int] | None:
        """The two neighbouring values up to the margin that are the furthest apart."""
        return max(self._neighbours, key=lambda pair: pair[1] - pair[0], default=None)

    @property
    def variants_at_most(self) -> int:
        """Largest number of variants that are left to begin, by `probes_at_most`."""
        begun = self.requested.keys() - self.outcomes.keys()
        return max(0, self.probes_at_most - len(begun)) * len(self.variants)

    @property
    def probes_at_most(self) -> int:
        """Largest number of remaining probes, if no value below one that held is lost."""
        margin, failure = self.margin, self.first_failure
        hints, limit = len(self._untried_hints), self.steps.limit
        if failure is not None:
            beyond = sum(value not in self.outcomes for value in self._beyond(failure))
            if margin is None:
                return hints + beyond
            is_bracketed = failure - margin == 1
            left = hints + (beyond if is_bracketed else len(_BEYOND))  # a lower failure has others
            left += (failure - margin - 1).bit_length()
            return left + self._gaps_at_most(is_bracketed=is_bracketed)
        left = hints + (margin is None) + self._gaps_at_most(is_bracketed=margin == limit)
        if margin == limit:
            return left
        doublings = max(map(self._doublings, (margin or 0, *self._untried_hints)))
        return left + doublings + limit.bit_length() + len(_BEYOND)

    def _doublings(self, margin: int) -> int:
        """Return the number of values that are probed from a margin to the limit, if all hold."""
        grown, count = margin, 0
        while grown < self.steps.limit:
            grown, count = min(2 * grown or self.steps.first, self.steps.limit), count + 1
        return count

    def _gaps_at_most(self, *, is_bracketed: bool) -> int:
        """Return the largest number of values that halve gaps; a longer margin has wider parts."""
        if not is_bracketed:
            return 2 * (self.parts - 1)
        return sum(self._halvings(high - low) for low, high in self._neighbours)

    @property
    def probes_left(self) -> int:
        """Number of remaining probes, if the next one of a bracketing fails."""
        margin, failure, hints = self.margin, self.first_failure, len(self._untried_hints)
        if failure is None:
            step = max(self.steps.first, margin or 0)
            return 1 + hints + step.bit_length() + self.parts + len(_BEYOND)
        left = hints + sum(value not in self.outcomes for value in self._beyond(failure))
        if margin is None:
            return left
        gaps = [high - low for low, high in (*self._neighbours, (margin, failure))]
        return left + (failure - margin - 1).bit_length() + sum(map(self._halvings, gaps))

    def next(self) -> int | None:
        """Return the value to probe next; None when the search is over."""
        margin, failure = self.margin, self.first_failure
        if margin is None and failure is None:
            return 0
        if hints := self._untried_hints:
            return hints[0]
        if margin is not None and (between := self._between(margin, failure)) is not None:
            return between
        further = [] if failure is None else self._beyond(failure)
        return next((value for value in further if value not in self.outcomes), None)

    def _between(self, margin: int, failure: int | None) -> int | None:
        """Return the next value that brackets the failure, or that halves a gap."""
        if failure is None:
            grown = min(2 * margin or self.steps.first, self.steps.limit)
            if grown > margin:
                return grown
        elif failure - margin > 1:
            return (margin + failure) // 2
        low, high = self.widest_gap or (0, 0)
        return (low + high) // 2 if self._halvings(high - low) else None

    @property
    def _untried_hints(self) -> list[int]:
        failure = self.first_failure
        last = self.steps.limit if failure is None else failure
        return [each for each in self.hints if each not in self.outcomes and each <= last]

    @property
    def _neighbours(self) -> list[tuple[int, int]]:
        """Pairs of neighbouring values that were probed, up to the margin."""
        margin = -1 if self.margin is None else self.margin
        return list(itertools.pairwise(sorted(each for each in self.outcomes if each <= margin)))

    def _halvings(self, width: int) -> int:
        """Return the number of values that make no gap within this width too wide."""
        if width <= max(1, math.ceil((self.margin or 0) / self.parts)):
            return 0
        return 1 + self._halvings(width // 2) + self._halvings(width - width // 2)

    def _beyond(self, failure: int) -> list[int]:
        """Return the values to probe beyond a failure."""
        further = (round(factor * failure) for factor in _BEYOND)
        return [value for value in further if failure < value <= self.steps.limit]

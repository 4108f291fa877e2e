"""The search for the value of a quantity at which a law loses its bounds."""

from __future__ import annotations

from dataclasses import dataclass, field

from deploy.judge.run_rows import Row
from deploy.study.plants import Variant

_BEYOND = (1.5, 2.0)


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

    From zero, values are doubled until one fails; the interval between the last that held and the
    first that failed is halved until they are neighbours. Finally two larger values are probed, as
    bounds may be kept again beyond a failure.

    Attributes:
        steps: the values that can be probed.
        outcomes: whether each probed value held.
        rows: rows of its runs, by the probed value in steps.
        variants: starts, or patterns from all starts, to run at each value.
        requested: number of variants that were requested, by the probed value in steps.
    """

    steps: Steps
    outcomes: dict[int, bool] = field(default_factory=dict)
    rows: dict[int, list[Row]] = field(default_factory=dict)
    variants: list[Variant] = field(default_factory=list)
    requested: dict[int, int] = field(default_factory=dict)

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

    @property
    def probes_left(self) -> int:
        """Number of remaining probes, if the next one of a bracketing fails."""
        margin, failure = self.margin, self.first_failure
        if failure is None:
            step = max(self.steps.first, margin or 0)
            return 1 + step.bit_length() + len(_BEYOND)
        left = (failure - margin - 1).bit_length() if margin is not None else 0
        return left + sum(value not in self.outcomes for value in self._beyond(failure))

    def next(self) -> int | None:
        """Return the value to probe next; None when the search is over."""
        margin, failure = self.margin, self.first_failure
        if failure is None:
            if margin is None:
                return 0
            grown = min(2 * margin or self.steps.first, self.steps.limit)
            return grown if grown > margin else None
        if margin is not None and failure - margin > 1:
            return (margin + failure) // 2
        untried = (value for value in self._beyond(failure) if value not in self.outcomes)
        return next(untried, None)

    def _beyond(self, failure: int) -> list[int]:
        """Return the values to probe beyond a failure."""
        further = (round(factor * failure) for factor in _BEYOND)
        return [value for value in further if failure < value <= self.steps.limit]

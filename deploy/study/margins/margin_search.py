"""The search for the largest value that holds: bracketing by doubling, then bisection."""

from __future__ import annotations

from dataclasses import dataclass, field

_BEYOND = (1.5, 2.0)


@dataclass
class MarginSearch:
    """Which value to probe next, in whole steps of the resolution.

    From nothing on, values are doubled until one fails; what lies between the last that held and
    the first that failed is halved until they are neighbours. In the end two values further out are
    probed, to find out whether larger ones hold again: what holds need not be an interval.

    Attributes:
        first: the first value probed after zero, in steps.
        limit: the largest value probed, in steps.
        outcomes: whether each probed value held.
    """

    first: int
    limit: int
    outcomes: dict[int, bool] = field(default_factory=dict)

    @property
    def first_failure(self) -> int | None:
        """The smallest value that failed."""
        return min((value for value, held in self.outcomes.items() if not held), default=None)

    @property
    def margin(self) -> int | None:
        """The largest value up to which all that were probed held; None where zero failed."""
        failure = self.first_failure
        holding = (
            value
            for value, held in self.outcomes.items()
            if held and (failure is None or value < failure)
        )
        return max(holding, default=None)

    @property
    def held_again(self) -> list[int]:
        """Values beyond the first failure that held."""
        failure = self.first_failure
        if failure is None:
            return []
        return sorted(value for value, held in self.outcomes.items() if held and value > failure)

    @property
    def probes_left(self) -> int:
        """How many values are still to be probed, if the next one of a bracketing fails."""
        margin, failure = self.margin, self.first_failure
        if failure is None:
            step = max(self.first, margin or 0)
            return 1 + step.bit_length() + len(_BEYOND)
        left = (failure - margin - 1).bit_length() if margin is not None else 0
        return left + sum(value not in self.outcomes for value in self._beyond(failure))

    def next(self) -> int | None:
        """The value to probe next; None when the search is over."""
        margin, failure = self.margin, self.first_failure
        if failure is None:
            if margin is None:
                return 0
            grown = min(2 * margin or self.first, self.limit)
            return grown if grown > margin else None
        if margin is not None and failure - margin > 1:
            return (margin + failure) // 2
        untried = (value for value in self._beyond(failure) if value not in self.outcomes)
        return next(untried, None)

    def _beyond(self, failure: int) -> list[int]:
        """Values beyond a failure that are worth a look."""
        further = (round(factor * failure) for factor in _BEYOND)
        return [value for value in further if failure < value <= self.limit]

"""A sequential test of a share: Wald's, truncated at the number of a test of fixed size."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from bus_schema.arrays import Vector

_ERROR = 0.05
_BISECTIONS = 50
_ROUNDING = 1e-9


class _End(NamedTuple):
    """Counts with which a test ends, its decision, and the log of the number of ways to them."""

    kept: int
    lost: int
    passes: bool
    log_ways: float


@dataclass(frozen=True)
class SequentialTest:
    """Test whether enough of all items are kept: as surely as `most` items would show it, by fewer.

    `most` items pass if `share` of them are kept. That would be so with a probability of 5 % if
    `poor_share` of all items were kept, and of 95 % if `good_share` were. Wald's sequential
    probability ratio test between these two, with errors of 5 %, ends earlier; after `most` items
    their share decides.

    Attributes:
        share: share that must be kept.
        most: largest number of items.
    """

    share: float
    most: int

    def decide(self, kept: int, lost: int) -> bool | None:
        """Return whether enough are kept; None if that needs more items."""
        if lost > self.most - self._needed:
            return False
        if kept + lost >= self.most:
            return True
        for_kept, for_lost = self._weights
        ratio, enough = kept * for_kept + lost * for_lost, math.log((1.0 - _ERROR) / _ERROR)
        return None if abs(ratio) < enough - _ROUNDING else ratio > 0.0

    @cached_property
    def poor_share(self) -> float:
        """Share of all items with which a fixed number passes in 5 % of cases."""
        return _solve(self._passes_when_fixed, _ERROR)

    @cached_property
    def good_share(self) -> float:
        """Share of all items with which a fixed number passes in 95 % of cases."""
        return _solve(self._passes_when_fixed, 1.0 - _ERROR)

    @property
    def error_probabilities(self) -> dict[str, float]:
        """Both shares, and the exact probabilities that this test decides wrongly at them."""
        passes = np.array([end.passes for end in self._ends])
        return {
            "poor_share": self.poor_share,
            "passes_at_poor_share": float(self._chances(self.poor_share) @ passes),
            "good_share": self.good_share,
            "fails_at_good_share": float(self._chances(self.good_share) @ ~passes),
        }

    def interval(self, kept: int, lost: int) -> tuple[float, float]:
        """Return an exact 95 % interval of the share of all items, after the test ended with these.

        Outcomes are ordered by their share. At either end, outcomes at least as far away have a
        probability of 2.5 % (Clopper and Pearson's interval, with the probabilities of this test).
        """
        shares = np.array([end.kept / (end.kept + end.lost) for end in self._ends])
        found, tail = kept / (kept + lost), 0.5 * _ERROR
        above, below = shares >= found - _ROUNDING, shares <= found + _ROUNDING
        low = _solve(lambda share: float(self._chances(share) @ above), tail)
        high = _solve(lambda share: -float(self._chances(share) @ below), -tail)
        return 0.0 if not kept else low, 1.0 if not lost else high

    @property
    def _needed(self) -> int:
        return math.ceil(self.share * self.most - _ROUNDING)

    @cached_property
    def _weights(self) -> tuple[float, float]:
        """Logarithms of the ratio of both hypotheses' probabilities, of a kept and a lost item."""
        poor, good = self.poor_share, self.good_share
        return math.log(good / poor), math.log((1.0 - good) / (1.0 - poor))

    def _passes_when_fixed(self, share: float) -> float:
        kept = np.arange(self._needed, self.most + 1)
        logs = np.array([math.log(math.comb(self.most, each)) for each in kept])
        return float(np.exp(logs + _log_probability(kept, self.most - kept, share)).sum())

    @cached_property
    def _ends(self) -> list[_End]:
        ends, ways = list[_End](), {0: 1}  # by the number of lost items
        for items in range(1, self.most + 1):
            reached: dict[int, int] = {}
            for lost, count in ways.items():
                for after in (lost, lost + 1):
                    reached[after] = reached.get(after, 0) + count
            ways = {}
            for lost, count in reached.items():
                passes = self.decide(items - lost, lost)
                if passes is None:
                    ways[lost] = count
                else:
                    ends.append(_End(items - lost, lost, passes, math.log(count)))
        return ends

    def _chances(self, share: float) -> Vector:
        """Return the probability of each end, if this share of all items is kept."""
        kept, lost, _, log_ways = np.array(self._ends, dtype=np.float64).T
        return np.asarray(np.exp(log_ways + _log_probability(kept, lost, share)))


def _log_probability(kept: Any, lost: Any, share: float) -> Vector:
    return np.asarray(kept * math.log(share) + lost * math.log1p(-share), dtype=np.float64)


def _solve(rising: Callable[[float], float], wanted: float) -> float:
    """Return the share at which a rising function has this value."""
    low, high = 0.0, 1.0
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if rising(middle) < wanted else (low, middle)
    return min(max(0.5 * (low + high), 1e-12), 1.0 - 1e-12)

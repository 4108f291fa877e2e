"""Search for the gains of a law: CMA-ES on the logarithms of their factors."""

from __future__ import annotations

import math
import warnings
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.errors import InputError, needs_extra

Gains = dict[str, Any]
"""Numbers, and lists of them by joint, by name."""

FIXED = frozenset(
    {"phi_1", "phi_2", "gamma_1", "gamma_2", "phi", "psi", "power", "eta", "boundary_layer"}
    | {"delayed_node_width", "delayed_adaptation", "delayed_k_2", "half_way_s", "opening"}
)
"""Gains that no search changes: powers, widths near zero, and those of delay compensation alone."""

_SPREAD = 0.3
_WIDEST = math.log(1000.0)
_DIGITS = 4


class _Entry(NamedTuple):
    """A number that is tuned, with the limits of the logarithm of its factor."""

    name: str
    place: int | None
    value: float
    least: float
    most: float


class GainSearch:
    """A search for the gains with the least cost, in generations.

    Gains are rounded to four digits, so that the arithmetic of a computer changes no candidate.

    Args:
        start: the gains to begin with, the first candidate.
        budget: number of candidates.
        seed: of the search.
        ranges: least and largest value of gains, from which a gain beyond them starts in the
            middle; of others, a factor of 1000 either way.
        fixed: names of gains that are not tuned.

    Attributes:
        candidates: all so far.
        costs: those of the candidates that are known, in their order.

    Raises:
        InputError: there is nothing to tune.
    """

    def __init__(
        self, start: Gains, budget: int, seed: int, ranges: Mapping[str, tuple[float, float]],
        fixed: Collection[str] = FIXED,
    ) -> None:  # fmt: skip
        try:
            with warnings.catch_warnings():  # it warns that it cannot plot
                warnings.simplefilter("ignore")
                import cma  # of the extra `tuning`, which nothing else needs
        except ImportError as error:
            raise InputError(f"the search {needs_extra('cma', 'tuning')}") from error
        start = _within(start, ranges)
        self._entries = list(_entries(start, ranges, fixed))
        if not self._entries:
            raise InputError("has no gain above 0 to tune")
        # CMA-ES needs two dimensions; a second one of no effect does no harm.
        count = max(2, len(self._entries))
        limits = [[e.least for e in self._entries], [e.most for e in self._entries]]
        limits = [bound + [sign * _WIDEST] * (count - len(bound))
                  for bound, sign in zip(limits, (-1, 1), strict=True)]  # fmt: skip
        random = np.random.RandomState(seed)  # its own: searches of several laws interleave
        options = {"seed": np.nan, "randn": random.randn, "bounds": limits, "verbose": -9,
                   "verb_log": 0}  # fmt: skip
        self._strategy = cma.CMAEvolutionStrategy(np.zeros(count), _SPREAD, options)
        self._start, self._budget = start, budget
        self._population: list[Vector] = []
        self.candidates: list[Gains] = [start]
        self.costs: list[float] = []

    @property
    def is_over(self) -> bool:
        """Whether the budget is used, and all costs are known."""
        return len(self.costs) >= self._budget

    @property
    def best(self) -> int:
        """Number of the candidate with the least cost; the first of equal ones."""
        return int(np.argmin(self.costs))

    @property
    def spread(self) -> float:
        """Largest standard deviation of a factor's logarithm in the search's distribution."""
        return float(np.max(self._strategy.result.stds[: len(self._entries)]))

    def tell(self, costs: Sequence[float]) -> None:
        """Take the costs of all candidates that have none yet, and add the next generation."""
        self.costs += costs
        if len(self._population) == len(costs) and self._population:
            self._strategy.tell(self._population, list(costs))
        left = self._budget - len(self.costs)
        self._population = self._strategy.ask() if left > 0 else []
        self.candidates += [self._with(factors) for factors in self._population[:left]]

    def _with(self, log_factors: Vector) -> Gains:
        gains = {k: list(v) if isinstance(v, list) else v for k, v in self._start.items()}
        for entry, log_factor in zip(self._entries, log_factors, strict=False):
            value = float(f"{entry.value * math.exp(log_factor):.{_DIGITS}g}")
            if entry.place is None:
                gains[entry.name] = value
            else:
                gains[entry.name][entry.place] = value
        return gains


def _within(start: Gains, ranges: Mapping[str, tuple[float, float]]) -> Gains:
    """Return gains within their ranges; those beyond them are in the middle of its logarithm."""

    def moved(value: float, low: float, high: float) -> float:
        return value if low <= value <= high else math.sqrt(low * high)

    found = {k: list(v) if isinstance(v, list) else v for k, v in start.items()}
    for name in ranges.keys() & start.keys():
        given = found[name]
        found[name] = (
            [moved(each, *ranges[name]) for each in given]
            if isinstance(given, list)
            else moved(given, *ranges[name])
        )
    return found


def _entries(
    start: Gains, ranges: Mapping[str, tuple[float, float]], fixed: Collection[str]
) -> Iterator[_Entry]:
    """Yield the numbers to tune; those that are 0 have no factor, and stay."""
    for name, given in start.items():
        if name in fixed:
            continue
        for place, value in enumerate(given) if isinstance(given, list) else [(None, given)]:
            if name in ranges:
                low, high = ranges[name]
                yield _Entry(name, place, value, math.log(low / value), math.log(high / value))
            elif value > 0.0:
                yield _Entry(name, place, value, -_WIDEST, _WIDEST)

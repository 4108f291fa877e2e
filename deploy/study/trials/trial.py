"""The runs at one value: one variant after the other, until those known decide."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from deploy.judge.run_rows import Row, left_nothing, tolerated, uses_seed
from deploy.study.planned_run import PlannedRun
from deploy.study.trials.sequential_test import SequentialTest

Key = tuple[str, int]
_UNKNOWN = 0, math.inf


class _Known(NamedTuple):
    """State of a trial, from its rows.

    Attributes:
        outcome: whether the value is tolerated; None if that is not decided.
        judged: the variants that count for the decision, each with its rows.
        missing: runs that may still be needed, in order; other seeds than the first come later.
    """

    outcome: bool | None
    judged: list[tuple[PlannedRun, list[Row]]]
    missing: list[PlannedRun]


@dataclass
class Trial:
    """The runs of several variants at one value, and what they decide.

    A variant is kept if its runs are tolerated with every seed; one with a lost run is lost. Rows
    may arrive in any order: only those before the decision count.

    Attributes:
        test: decides from the number of kept and lost variants.
        runs: one run of each variant, in the order in which they are tried.
        seeds: the seeds to try, in order, by point.
        is_exhaustive: decide only when every variant has been tried with every seed.
        rows: the rows of its runs so far.
        known: what they show.
    """

    test: SequentialTest
    runs: Sequence[PlannedRun]
    seeds: Mapping[str, Sequence[int]]
    is_exhaustive: bool
    rows: dict[Key, Row] = field(default_factory=dict)
    _requested: set[Key] = field(default_factory=set, init=False)

    def __post_init__(self) -> None:
        self.known = self._walk()

    def add(self, run: PlannedRun, row: Row) -> None:
        """Add the row of a run."""
        self.rows[run.key] = row
        self.known = self._walk()

    @property
    def planned(self) -> int:
        """Number of runs of all variants with all seeds, as far as known."""
        is_random = any(map(uses_seed, self.rows.values()))
        return sum(len(self.seeds[run.point]) if is_random else 1 for run in self.runs)

    @property
    def expected(self) -> int:
        """Number of its runs, as far as known: those until its decision, or all."""
        return self.planned if self.known.outcome is None else len(self.rows)

    @property
    def at_most(self) -> int:
        """Largest number of its runs: those until its decision, or all that may be needed."""
        if self.known.outcome is not None:
            return len(self.rows)
        return self.planned if self.rows else sum(len(self.seeds[run.point]) for run in self.runs)

    def request(self) -> list[PlannedRun]:
        """Return the runs that are needed now, and that were not requested before."""
        missing = self.known.missing
        needed = missing if self.is_exhaustive else missing[:1]
        new = [run for run in needed if run.key not in self._requested]
        self._requested.update(run.key for run in new)
        return new

    def _walk(self) -> _Known:
        judged, missing, kept = list[tuple[PlannedRun, list[Row]]](), list[PlannedRun](), 0
        for run in self.runs:
            rows, left = self._known(run)
            if any(map(left_nothing, rows)) and not self.is_exhaustive:
                return _Known(None, judged, [])  # until a later command repeats it
            missing += left
            if left or (missing and not self.is_exhaustive) or any(map(left_nothing, rows)):
                continue
            judged.append((run, rows))
            kept += all(map(tolerated, rows))
            outcome = self.test.decide(kept, len(judged) - kept)
            if outcome is not None and not self.is_exhaustive:
                return _Known(outcome, judged, [])
        outcome = (
            self.test.decide(kept, len(judged) - kept) if len(judged) == len(self.runs) else None
        )
        return _Known(outcome, judged, missing)

    def _known(self, run: PlannedRun) -> tuple[list[Row], list[PlannedRun]]:
        """Return the rows of a variant, and its missing runs, none after one that was lost."""
        seeds = self.seeds[run.point]
        own = [replace(run, seed=seed) for seed in seeds]
        rows = [self.rows[each.key] for each in own if each.key in self.rows]
        if not rows:
            return [], own[:1]
        is_lost = not all(map(tolerated, rows)) and not self.is_exhaustive
        if is_lost or not any(map(uses_seed, rows)):
            return rows, []
        return rows, [each for each in own if each.key not in self.rows]


def worst_first(
    runs: Sequence[PlannedRun], seeds: Sequence[int], earlier: Iterable[Row]
) -> tuple[list[PlannedRun], dict[str, list[int]]]:
    """Return runs, and seeds by point, in the order in which to try them.

    The variant and the seed go first that were lost most often, then those with the smallest
    margin.

    Args:
        runs: one run of each variant.
        seeds: the seeds.
        earlier: rows of the same variants at other values.
    """
    found = dict[Key, tuple[int, float]]()
    for row in earlier:
        key, margin = (_variant(row["point"]), row["seed"]), row["margin_min"]
        losses, least = found.get(key, _UNKNOWN)
        least = least if margin is None else min(least, margin)
        found[key] = (losses - (not tolerated(row)), least)

    def rank(point: str, seed: int) -> tuple[int, float]:
        return found.get((_variant(point), seed), _UNKNOWN)

    by_point = {p: sorted(seeds, key=lambda seed: rank(p, seed)) for p in (r.point for r in runs)}
    return sorted(runs, key=lambda run: rank(run.point, by_point[run.point][0])), by_point


def runs_ahead(trials: Iterable[Trial]) -> Iterator[PlannedRun]:
    """Return the runs that trials may need next, beyond those requested, of each in turn."""
    by_turn = itertools.zip_longest(*(trial.known.missing[1:] for trial in trials))
    return (run for turn in by_turn for run in turn if run is not None)


def _variant(point: str) -> str:
    return point.rpartition("-")[2]

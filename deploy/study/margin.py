"""Margins: how much delay, jitter, loss or anything else a law takes before it loses its bounds."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from pydantic import Field

from bus_schema.configuration import Number, Positive
from deploy.judge.run_rows import Row, held, left_nothing
from deploy.scenario.scenario import load_setup
from deploy.scenario.study_keys import UNCERTAINTY, seeds_that_differ
from deploy.scenario.yaml_files import override
from deploy.study.cases import (
    CASE_COLUMNS,
    Case,
    CasesDefinition,
    Setting,
    StudyOfCases,
    settings,
)
from deploy.study.quantities import Steps
from deploy.study.statistics import badness, spread_of_runs
from deploy.study.study import Different, PlannedRun, Seeds

_BEYOND = (1.5, 2.0)


class MarginDefinition(CasesDefinition):
    """What to find margins of, as a study's YAML file has it.

    Attributes:
        offsets: factors on the scenario's initial offset; a value holds if the bounds are kept from
            every one of these starts, with every seed.
        resolution: to which the margin is found, in the quantity's unit.
        limit: the last value tried, in the quantity's unit; for a number of the scenario it may lie
            below the scenario's own, from which the search begins.
    """

    seeds: Seeds = Field(default=[1, 2])
    offsets: Different[Number] = Field(default=[1.0, -0.5])
    resolution: Positive | None = None
    limit: Number | None = None


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


@dataclass
class _Search(Case):
    """A search for the margin of a setting.

    Attributes:
        steps: the values of its search.
        search: how far that is.
        seeds: those of its runs: one is enough where nothing is random.
        rows: what came of its runs, by the probed value in steps.
    """

    steps: Steps
    search: MarginSearch
    seeds: list[int]
    rows: dict[int, list[Row]] = field(default_factory=dict)


class Margin(StudyOfCases[_Search]):
    """The runs of a search for margins."""

    kind = "margin"
    definition_type = MarginDefinition
    definition: MarginDefinition
    columns = MappingProxyType({**CASE_COLUMNS, "offset_scale": "double"})

    @property
    def expected(self) -> int:
        return sum(
            (case.search.probes_left + len(case.search.outcomes)) * self._runs_per_probe(case)
            for case in self.cases
        )

    def first(self) -> Iterable[PlannedRun]:
        return [run for case in range(len(self.cases)) for run in self._next_probe(case)]

    def follow(self, run: PlannedRun, values: Row) -> Iterable[PlannedRun]:
        index, steps = map(int, run.point.split("-")[:2])
        case = self.cases[index]
        rows = case.rows.setdefault(steps, [])
        rows.append(values)
        if len(rows) < self._runs_per_probe(case):
            return ()
        if any(map(left_nothing, rows)):
            return ()  # nobody knows whether this value holds, so the search ends here
        case.search.outcomes[steps] = all(held(row) for row in rows)
        return self._next_probe(index)

    def case_findings(self, _rows: list[Row]) -> dict[str, Any]:
        steps = self.cases[0].steps
        return {
            "resolution": steps.resolution,
            "limit": steps.value(steps.limit),
            "completed": all(case.search.next() is None for case in self.cases),
            "offsets": self.definition.offsets,
            "cases": [_case_summary(case) for case in self.cases],
        }

    def _runs_per_probe(self, case: _Search) -> int:
        return len(case.seeds) * len(self.definition.offsets)

    def build_cases(self) -> Iterator[_Search]:
        wanted = self.definition
        for setting in settings(wanted, {UNCERTAINTY: "beside plants (--plants)"}):
            steps = setting.quantity.steps(wanted.resolution, wanted.limit)
            last, search = steps.value(steps.limit), MarginSearch(steps.first, steps.limit)
            setups = [
                load_setup(setting.scenario, setting.at(last, _start(setting, scale)))
                for scale in wanted.offsets
            ]
            seeds = seeds_that_differ(setups[0], wanted.seeds)
            yield _Search(setting, self.ceilings_ms(setting, setups), steps, search, seeds)

    def _next_probe(self, index: int) -> list[PlannedRun]:
        case = self.cases[index]
        steps = case.search.next()
        if steps is None:
            return []
        return [
            run
            for start, scale in enumerate(self.definition.offsets)
            for run in self.planned(
                _point(index, steps, start), case.setting, case.steps.value(steps), case.seeds,
                _start(case.setting, scale), {"offset_scale": scale},
            )
        ]  # fmt: skip


def _start(setting: Setting, offset_scale: float) -> list[str]:
    own = setting.base.scenario.robot.initial_offset_rad
    return [override("robot.initial_offset_rad", (offset_scale * own).tolist())]


def _case_summary(case: _Search) -> dict[str, Any]:
    search = case.search

    def value(steps: int | None) -> float | None:
        return None if steps is None else case.steps.value(steps)

    return {
        **case.setting.tags,
        "margin": value(search.margin),
        "first_failure": value(search.first_failure),
        "margin_on": {physics: value(steps) for physics, steps in _margins_elsewhere(case).items()},
        "held_again": [value(steps) for steps in search.held_again],
        "held_arm_ceiling_ms": min(case.ceilings_ms, default=None),
        "growth": case.steps.growth,
        "seeds": case.seeds,
        "completed": search.next() is None,
        "probes": [
            _probe_summary(case, steps, sorted(rows, key=lambda row: (row["point"], row["seed"])))
            for steps, rows in sorted(case.rows.items())
        ],
    }


def _margins_elsewhere(case: _Search) -> dict[str, int | None]:
    """Of the values tried, the last one up to which all were kept, by other physics, in steps."""
    kept = {steps: list(map(_kept_elsewhere, rows)) for steps, rows in sorted(case.rows.items())}
    found: dict[str, int | None] = {}
    for physics in dict.fromkeys(name for rows in kept.values() for row in rows for name in row):
        found[physics] = None
        for steps, rows in kept.items():
            if not all(row.get(physics) for row in rows):
                break
            found[physics] = steps
    return found


def _kept_elsewhere(row: Row) -> dict[str, bool]:
    """Whether a run kept its bounds, by other physics; of a failed one nothing is known."""
    return dict(zip(row.get("confirmed_on") or (), row.get("confirmed_kept") or (), strict=True))


def _probe_summary(case: _Search, steps: int, rows: list[Row]) -> dict[str, Any]:
    return {
        "value": case.steps.value(steps),
        "held": case.search.outcomes.get(steps),
        "points": sorted({row["point"] for row in rows}),
        "worst_point": max(rows, key=badness)["point"],
        **spread_of_runs(rows),
    }


def _point(case: int, steps: int, start: int) -> str:
    """Name of a point: case, value and start, so that names sort as they are searched."""
    return f"{case:03d}-{steps:06d}-{start:02d}"

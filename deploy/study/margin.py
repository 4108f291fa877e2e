"""Margins: how much delay, jitter, loss or other quantity a law tolerates within its bounds."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pydantic import Field

from bus_schema.configuration import Number, Positive
from deploy.judge.run_rows import Row, held, left_nothing
from deploy.scenario.study_keys import UNCERTAINTY
from deploy.scenario.yaml_files import override
from deploy.study.cases import CASE_COLUMNS, CasesDefinition, Setting, StudyOfCases
from deploy.study.plants import Variant
from deploy.study.quantities import Steps
from deploy.study.statistics import badness, spread_of_runs
from deploy.study.study import Different, PlannedRun, Seeds

_BEYOND = (1.5, 2.0)


class MarginDefinition(CasesDefinition):
    """Settings of a search for margins, as in a study's YAML file.

    Attributes:
        offsets: factors on the scenario's initial offset; a value holds if the bounds are kept from
            every one of these starts, with every seed.
        resolution: resolution of the margin, in the quantity's unit.
        limit: the last value tried, in the quantity's unit; for a number of the scenario it may lie
            below the scenario's own value, where the search begins.
    """

    seeds: Seeds = Field(default=[1, 2])
    offsets: Different[Number] = Field(default=[1.0, -0.5])
    resolution: Positive | None = None
    limit: Number | None = None


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
    """

    steps: Steps
    outcomes: dict[int, bool] = field(default_factory=dict)
    rows: dict[int, list[Row]] = field(default_factory=dict)

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


class Margin(StudyOfCases):
    """The runs of a search for margins.

    Attributes:
        searches: the search of each case.
    """

    kind = "margin"
    definition_type = MarginDefinition
    definition: MarginDefinition
    columns = MappingProxyType({**CASE_COLUMNS, "offset_scale": "double"})
    own_keys = MappingProxyType({UNCERTAINTY: "beside plants (--plants)"})

    def __init__(self, values: Mapping[str, Any], source: Path) -> None:
        super().__init__(values, source)
        self.searches = [MarginSearch(self._steps(case.setting)) for case in self.cases]

    def _steps(self, setting: Setting) -> Steps:
        return setting.quantity.steps(self.definition.resolution, self.definition.limit)

    def last_value(self, setting: Setting) -> float:
        steps = self._steps(setting)
        return steps.value(steps.limit)

    def variants_of(self, setting: Setting) -> list[Variant]:
        own, key = setting.base.scenario.robot.initial_offset_rad, "robot.initial_offset_rad"
        return [
            Variant(number, (override(key, (scale * own).tolist()),), {"offset_scale": scale})
            for number, scale in enumerate(self.definition.offsets)
        ]

    @property
    def expected(self) -> int:
        return sum(
            (search.probes_left + len(search.outcomes)) * case.runs_per_value
            for case, search in zip(self.cases, self.searches, strict=True)
        )

    def first(self) -> Iterable[PlannedRun]:
        return [run for case in range(len(self.cases)) for run in self._next_probe(case)]

    def follow(self, run: PlannedRun, values: Row) -> Iterable[PlannedRun]:
        index, steps = map(int, run.point.split("-")[:2])
        search = self.searches[index]
        rows = search.rows.setdefault(steps, [])
        rows.append(values)
        if len(rows) < self.cases[index].runs_per_value or any(map(left_nothing, rows)):
            return ()  # unknown so far, or for good, whether this value holds
        search.outcomes[steps] = all(map(held, rows))
        return self._next_probe(index)

    def _next_probe(self, index: int) -> Iterable[PlannedRun]:
        search = self.searches[index]
        steps = search.next()
        return () if steps is None else self.runs_at(index, steps, search.steps.value(steps))

    def case_findings(self, _rows: list[Row]) -> dict[str, Any]:
        steps = self.searches[0].steps
        return {
            "resolution": steps.resolution,
            "limit": steps.value(steps.limit),
            "completed": all(search.next() is None for search in self.searches),
            "offsets": self.definition.offsets,
            "cases": [
                {**case.findings, **_search_findings(search), "seeds": case.seeds[0]}
                for case, search in zip(self.cases, self.searches, strict=True)
            ],
        }


def _search_findings(search: MarginSearch) -> dict[str, Any]:
    def value(steps: int | None) -> float | None:
        return None if steps is None else search.steps.value(steps)

    return {
        "margin": value(search.margin),
        "first_failure": value(search.first_failure),
        "margin_on": {on: value(steps) for on, steps in _margins_elsewhere(search).items()},
        "held_again": list(map(value, search.held_again)),
        "growth": search.steps.growth,
        "completed": search.next() is None,
        "probes": [
            {
                "value": value(steps),
                "held": search.outcomes.get(steps),
                "points": sorted({row["point"] for row in rows}),
                "worst_point": max(_in_order(rows), key=badness)["point"],
                **spread_of_runs(_in_order(rows)),
            }
            for steps, rows in sorted(search.rows.items())
        ],
    }


def _in_order(rows: list[Row]) -> list[Row]:
    """Return rows by point and seed, in any order of execution."""
    return sorted(rows, key=lambda row: (row["point"], row["seed"]))


def _margins_elsewhere(search: MarginSearch) -> dict[str, int | None]:
    """Return the last tried value up to which all were kept, by other physics, in steps."""
    kept = {steps: list(map(_kept_elsewhere, rows)) for steps, rows in sorted(search.rows.items())}
    found: dict[str, int | None] = {}
    for physics in dict.fromkeys(name for rows in kept.values() for row in rows for name in row):
        found[physics] = None
        for steps, rows in kept.items():
            if not all(row.get(physics) for row in rows):
                break
            found[physics] = steps
    return found


def _kept_elsewhere(row: Row) -> dict[str, bool]:
    """Whether a run kept its bounds, by other physics; nothing is known of a failed run."""
    return dict(zip(row.get("confirmed_on") or (), row.get("confirmed_kept") or (), strict=True))

"""Margins: how much delay, jitter, loss or anything else a law takes before it loses its bounds."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import Field

from bus_schema.configuration import Number, Positive
from deploy.runs.run_rows import Row, held, left_nothing
from deploy.scenario.randomness import seeds_that_differ
from deploy.scenario.scenario import load_setup
from deploy.scenario.study_keys import UNCERTAINTY, require_link_effect
from deploy.scenario.yaml_files import naming, override, validated
from deploy.study.cases import (
    CASE_COLUMNS,
    CasesDefinition,
    Setting,
    bases_of,
    scenarios_of,
    settings,
)
from deploy.study.held_arm import ceiling_of_value
from deploy.study.margins.margin_search import MarginSearch
from deploy.study.margins.quantities import Steps
from deploy.study.statistics import badness, spread_of_runs
from deploy.study.study import Different, Run, Seeds, Study


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
class Case:
    """Something that has a margin.

    Attributes:
        setting: what it is.
        steps: the values of its search.
        search: how far that is.
        ceilings_ms: how long the arm may be held at each start.
        seeds: those of its runs: one is enough where nothing is random.
        rows: what came of its runs, by the probed value in steps.
    """

    setting: Setting
    steps: Steps
    search: MarginSearch
    ceilings_ms: list[float]
    seeds: list[int]
    rows: dict[int, list[Row]] = field(default_factory=dict)


class Margin(Study):
    """The runs of a search for margins.

    Attributes:
        cases: what has a margin, each with its search.
    """

    kind = "margin"
    definition: MarginDefinition

    def __init__(self, values: Mapping[str, Any], source: Path) -> None:
        given = validated(values, MarginDefinition, source)
        self.columns = {**CASE_COLUMNS, "offset_scale": "double"}
        with naming(source):
            changes = {"scenarios": scenarios_of(given, source)}
            self.definition = given.model_copy(update=changes)
            self.cases = list(self._build_cases())
            self.bases = bases_of([case.setting for case in self.cases])
            require_link_effect({**given.fixed, given.quantity: None}, self.bases)

    @property
    def laws(self) -> set[str]:
        return {case.setting.law for case in self.cases}

    @property
    def expected(self) -> int:
        return sum(
            (case.search.probes_left + len(case.search.outcomes)) * self._runs_per_probe(case)
            for case in self.cases
        )

    def first(self) -> Iterable[Run]:
        return [run for case in range(len(self.cases)) for run in self._next_probe(case)]

    def follow(self, run: Run, values: Row) -> Iterable[Run]:
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

    def findings(self, _rows: list[Row]) -> dict[str, Any]:
        first = self.cases[0]
        return {
            "quantity": self.definition.quantity,
            "title": first.setting.quantity.title,
            "unit": first.setting.quantity.unit,
            "resolution": first.steps.resolution,
            "limit": first.steps.value(first.steps.limit),
            "completed": all(case.search.next() is None for case in self.cases),
            "offsets": self.definition.offsets,
            "duration_s": {base.scenario.name: base.scenario.duration_s for base in self.bases},
            "cases": [_case_summary(case) for case in self.cases],
        }

    def _runs_per_probe(self, case: Case) -> int:
        return len(case.seeds) * len(self.definition.offsets)

    def _build_cases(self) -> Iterator[Case]:
        """All cases, each checked from every start at the last value."""
        wanted = self.definition
        for setting in settings(wanted, {UNCERTAINTY: "beside plants (--plants)"}):
            steps = setting.quantity.steps(wanted.resolution, wanted.limit)
            case = Case(setting, steps, MarginSearch(steps.first, steps.limit), [], [])
            last = steps.value(steps.limit)
            for scale in wanted.offsets:
                setup = load_setup(setting.scenario, _overrides(case, last, scale))
                case.seeds = seeds_that_differ(setup, wanted.seeds)
                if wanted.quantity == "delay" and not setting.running:
                    ceiling = ceiling_of_value(setup, wanted.direction)
                    case.ceilings_ms += [] if ceiling is None else [ceiling]
            yield case

    def _next_probe(self, index: int) -> list[Run]:
        case = self.cases[index]
        steps = case.search.next()
        if steps is None:
            return []
        value, runs = case.steps.value(steps), []
        for start, scale in enumerate(self.definition.offsets):
            columns = {**case.setting.tags, "quantity": self.definition.quantity,
                       "value": value, "offset_scale": scale}  # fmt: skip
            overrides = _overrides(case, value, scale)
            runs += [
                Run(
                    _point(index, steps, start),
                    case.setting.scenario,
                    overrides,
                    seed,
                    columns,
                    bool(self.definition.confirm),
                )
                for seed in case.seeds
            ]
        return runs


def _overrides(case: Case, value: float, offset_scale: float) -> tuple[str, ...]:
    own = case.setting.base.scenario.robot.initial_offset_rad
    start = override("robot.initial_offset_rad", (offset_scale * own).tolist())
    return case.setting.at(value, [start])


def _case_summary(case: Case) -> dict[str, Any]:
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


def _margins_elsewhere(case: Case) -> dict[str, int | None]:
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


def _probe_summary(case: Case, steps: int, rows: list[Row]) -> dict[str, Any]:
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

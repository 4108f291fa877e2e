"""Margins: how much delay, jitter or loss a law takes before it loses its bounds."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field

from bus_schema.configuration import Positive, StrictModel
from controller.laws import LAWS
from deploy.runs.run_rows import Row
from deploy.scenario.scenario import Setup, load_setup
from deploy.scenario.yaml_files import ScenarioError
from deploy.study.definition import Name, Seeds, override, scenario_from
from deploy.study.margin_quantities import QUANTITIES
from deploy.study.margin_search import MarginSearch
from deploy.study.statistics import held, spread_of_runs
from deploy.study.study import Run

KIND = "margin"
_COLUMNS = {"arm": "string", "compensation": "bool", "quantity": "string", "value": "double",
            "offset_scale": "double"}  # fmt: skip


def _different(values: list[Any]) -> list[Any]:
    if not values or len(set(values)) < len(values):
        raise ValueError("one or more different values")
    return values


class MarginDefinition(StrictModel):
    """What to find margins of, as a study's YAML file has it.

    Attributes:
        name: of the study.
        scenarios: scenario files, or names of shipped ones.
        laws: control laws; all by default.
        compensation: values of ``controller.delay_compensation.enabled`` to try; as each scenario
            has it if none is given.
        quantity: what grows: ``delay`` (round trip, half each way), ``jitter`` or ``loss`` (each
            way).
        fixed: (in YAML ``set``) scenario values that are the same in all runs, by dotted key.
        duration_s: length of each run; the scenario's own if null.
        seeds: how many, or which.
        offsets: factors on the scenario's initial offset; a value holds if the bounds are kept from
            every one of these starts, with every seed.
        resolution: to which the margin is found, in the quantity's unit.
        limit: the largest value tried, in the quantity's unit.
    """

    name: Name = "margin"
    scenarios: Annotated[list[str], AfterValidator(_different)] = Field(default=["paper_arm"])
    laws: Annotated[list[str], AfterValidator(_different)] = Field(default=list(LAWS))
    compensation: Annotated[list[bool], AfterValidator(_different)] | None = None
    quantity: Literal["delay", "jitter", "loss"] = "delay"
    fixed: Annotated[dict[str, Any], Field(alias="set", default_factory=dict)]
    duration_s: Positive | None = 8.0
    seeds: Seeds = Field(default=[1, 2])
    offsets: Annotated[list[float], AfterValidator(_different)] = Field(default=[1.0, -0.5])
    resolution: Positive | None = None
    limit: Positive | None = None


@dataclass(frozen=True)
class Case:
    """Something that has a margin: a law on an arm, with or without compensation.

    Attributes:
        scenario: file or name.
        base: the scenario as it is without the quantity.
    """

    scenario: str
    base: Setup
    law: str
    compensation: bool | None
    overrides: tuple[str, ...]

    @property
    def columns(self) -> dict[str, Any]:
        """What tells it from other cases, by column."""
        return {"arm": self.base.scenario.name, "compensation": self.compensation}


class Margin:
    """The runs of a search for margins.

    Args:
        definition: what to find.
        folder: folder of its file, from which paths of scenarios start.
        source: what to call it in messages.

    Raises:
        ScenarioError: a case is no scenario that can be run.
    """

    kind = KIND

    def __init__(self, definition: MarginDefinition, folder: Path, source: str) -> None:
        self.definition = definition
        self.columns = _COLUMNS
        self.quantity = QUANTITIES[definition.quantity]
        self.resolution = definition.resolution or self.quantity.resolution
        self.limit = definition.limit or self.quantity.limit
        try:
            self.scenarios = [scenario_from(name, folder) for name in definition.scenarios]
            self.cases = list(self._build_cases())
        except ScenarioError as error:
            raise ScenarioError(f"{source}: {error}") from error
        first = max(1, round(self.quantity.first / self.resolution))
        limit = max(1, round(self.limit / self.resolution))
        self.searches = [MarginSearch(min(first, limit), limit) for _ in self.cases]
        self._rows: dict[tuple[int, int], list[Row]] = {}

    @property
    def name(self) -> str:
        return self.definition.name

    @property
    def seeds(self) -> list[int]:
        return self.definition.seeds

    @property
    def bases(self) -> list[Setup]:
        """The scenarios that it varies."""
        return list({case.base.scenario.name: case.base for case in self.cases}.values())

    @property
    def expected(self) -> int:
        """Number of runs, as far as can be told now."""
        left = sum(search.probes_left for search in self.searches)
        probed = sum(len(search.outcomes) for search in self.searches)
        return (left + probed) * self._runs_per_probe

    def definition_values(self) -> dict[str, Any]:
        """The definition as plain values, from which `restore` makes it again."""
        return self.definition.model_dump(by_alias=True) | {"scenarios": self.scenarios}

    def first(self) -> Iterable[Run]:
        """The first probe of every case."""
        return [run for case in range(len(self.cases)) for run in self._next_probe(case)]

    def follow(self, run: Run, values: Row) -> Iterable[Run]:
        """The next probe of a case, once all runs of its last one are done."""
        case, steps, _ = _parse_point(run.point)
        rows = self._rows.setdefault((case, steps), [])
        rows.append(values)
        if len(rows) < self._runs_per_probe:
            return ()
        self.searches[case].outcomes[steps] = all(held(row) for row in rows)
        return self._next_probe(case)

    def summary(self, rows: list[Row]) -> dict[str, Any]:
        """What came of it, case by case."""
        return {
            "kind": KIND,
            "name": self.name,
            "quantity": self.definition.quantity,
            "title": self.quantity.title,
            "unit": self.quantity.unit,
            "resolution": self.resolution,
            "limit": self.limit,
            "completed": all(search.next() is None for search in self.searches),
            "runs": len(rows),
            "runs_failed": sum(row["error"] is not None for row in rows),
            "seeds": self.seeds,
            "offsets": self.definition.offsets,
            "duration_s": {base.scenario.name: base.scenario.duration_s for base in self.bases},
            "cases": [self._case_summary(index, rows) for index in range(len(self.cases))],
        }

    @property
    def _runs_per_probe(self) -> int:
        return len(self.seeds) * len(self.definition.offsets)

    def _build_cases(self) -> Iterator[Case]:
        """All cases, each checked from every start at the largest value."""
        wanted = self.definition
        fixed = [override(key, value) for key, value in wanted.fixed.items()]
        if wanted.duration_s is not None:
            fixed.append(override("duration_s", wanted.duration_s))
        compensations: Sequence[bool | None] = wanted.compensation or [None]
        chosen = itertools.product(self.scenarios, wanted.laws, compensations)
        for scenario, law, compensation in chosen:
            overrides = (*fixed, override("controller.law", law))
            if compensation is not None:
                key = "controller.delay_compensation.enabled"
                overrides = (*overrides, override(key, compensation))
            case = Case(scenario, load_setup(scenario, overrides), law, compensation, overrides)
            for scale in wanted.offsets:
                load_setup(scenario, self._overrides(case, self.limit, scale))
            yield case

    def _overrides(self, case: Case, value: float, offset_scale: float) -> tuple[str, ...]:
        offset = (offset_scale * case.base.scenario.robot.initial_offset_rad).tolist()
        start = override("robot.initial_offset_rad", offset)
        return (*case.overrides, *self.quantity.overrides(value), start)

    def _value(self, steps: int) -> float:
        return round(steps * self.resolution, 9)

    def _next_probe(self, index: int) -> list[Run]:
        steps, case = self.searches[index].next(), self.cases[index]
        if steps is None:
            return []
        value, runs = self._value(steps), []
        for start, scale in enumerate(self.definition.offsets):
            columns = {**case.columns, "quantity": self.definition.quantity, "value": value,
                       "offset_scale": scale}  # fmt: skip
            overrides = self._overrides(case, value, scale)
            runs += [
                Run(_point(index, steps, start), case.scenario, overrides, seed, columns)
                for seed in self.seeds
            ]
        return runs

    def _case_summary(self, index: int, rows: list[Row]) -> dict[str, Any]:
        case, search = self.cases[index], self.searches[index]
        by_steps: dict[int, list[Row]] = {}
        for row in rows:
            of_case, steps, _ = _parse_point(row["point"])
            if of_case == index:
                by_steps.setdefault(steps, []).append(row)

        def value(steps: int | None) -> float | None:
            return None if steps is None else self._value(steps)

        return {
            "arm": case.base.scenario.name,
            "law": case.law,
            "compensation": case.compensation,
            "margin": value(search.margin),
            "first_failure": value(search.first_failure),
            "held_again": [value(steps) for steps in search.held_again],
            "completed": search.next() is None,
            "probes": [
                {
                    "value": value(steps),
                    "held": search.outcomes.get(steps),
                    "points": sorted({row["point"] for row in of_probe}),
                    "worst_point": max(of_probe, key=_badness)["point"],
                    **spread_of_runs(of_probe),
                }
                for steps, of_probe in sorted(by_steps.items())
            ],
        }


def restore(values: dict[str, Any], folder: Path) -> Margin:
    """A search from the definition that its folder keeps."""
    return Margin(MarginDefinition.model_validate(values), folder, str(folder))


def _badness(row: Row) -> tuple[bool, float]:
    """What the worst of several runs has most of: failure, then ticks outside its bounds."""
    return row["error"] is not None, row["violation_fraction"] or 0.0


def _point(case: int, steps: int, start: int) -> str:
    """Name of a point: case, value and start, so that names sort as they are searched."""
    return f"{case:03d}-{steps:06d}-{start:02d}"


def _parse_point(point: str) -> tuple[int, int, int]:
    case, steps, start = map(int, point.split("-"))
    return case, steps, start

"""Margins: how much delay, jitter or loss a law takes before it loses its bounds."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from bus_schema.configuration import Positive
from controller.laws import LAWS
from deploy.runs.run_rows import Row
from deploy.scenario.scenario import Setup, load_setup
from deploy.scenario.yaml_files import naming, override, validated
from deploy.study.margin_search import MarginSearch
from deploy.study.statistics import held, spread_of_runs
from deploy.study.study import Different, Name, Run, Seeds, Study, StudyDefinition, scenario_name


@dataclass(frozen=True)
class Quantity:
    """Something of the link that can be too much.

    Attributes:
        title: what it is called.
        unit: of its values.
        key: scenario key of each direction.
        share: what part of a value each direction gets.
        resolution: to which the margin is found.
        first: the first value tried.
        limit: the largest value tried.
    """

    title: str
    unit: str
    key: str
    share: float
    resolution: float
    first: float
    limit: float

    def overrides(self, value: float) -> list[str]:
        """What to set for a value."""
        return [
            override(f"link.{direction}.{self.key}", self.share * value)
            for direction in ("uplink", "downlink")
        ]


QUANTITIES = {
    "delay": Quantity("round trip", "ms", "delay_ms", 0.5, 0.5, 1.0, 128.0),
    "jitter": Quantity("jitter each way", "ms", "jitter_ms", 1.0, 0.5, 1.0, 32.0),
    "loss": Quantity("loss each way", "", "loss", 1.0, 0.005, 0.01, 0.9),
}


class MarginDefinition(StudyDefinition):
    """What to find margins of, as a study's YAML file has it.

    Attributes:
        scenarios: scenario files, or names of shipped ones.
        laws: control laws; all by default.
        compensation: values of ``controller.delay_compensation.enabled`` to try; as each scenario
            has it if none is given.
        quantity: what grows: ``delay`` (round trip, half each way), ``jitter`` or ``loss`` (each
            way).
        duration_s: length of each run; the scenario's own if null.
        offsets: factors on the scenario's initial offset; a value holds if the bounds are kept from
            every one of these starts, with every seed.
        resolution: to which the margin is found, in the quantity's unit.
        limit: the largest value tried, in the quantity's unit.
    """

    name: Name = "margin"
    scenarios: Different[str] = Field(default=["paper_arm"])
    laws: Different[str] = Field(default_factory=lambda: list(LAWS))
    compensation: Different[bool] | None = None
    quantity: Literal["delay", "jitter", "loss"] = "delay"
    duration_s: Positive | None = 8.0
    seeds: Seeds = Field(default=[1, 2])
    offsets: Different[float] = Field(default=[1.0, -0.5])
    resolution: Positive | None = None
    limit: Positive | None = None


@dataclass
class Case:
    """Something that has a margin: a law on an arm, with or without compensation.

    Attributes:
        scenario: file or name.
        base: the scenario as it is without the quantity.
        overrides: what is set in it but for the quantity and the start.
        search: how far its search is.
        rows: what came of its runs, by the probed value in steps of the resolution.
    """

    scenario: str
    base: Setup
    law: str
    compensation: bool | None
    overrides: tuple[str, ...]
    search: MarginSearch
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
        self.columns = {"arm": "string", "compensation": "bool", "quantity": "string",
                        "value": "double", "offset_scale": "double"}  # fmt: skip
        self._quantity = QUANTITIES[given.quantity]
        self._resolution = given.resolution or self._quantity.resolution
        self._limit = given.limit or self._quantity.limit
        with naming(source):
            scenarios = [scenario_name(name, source.parent) for name in given.scenarios]
            self.definition = given.model_copy(update={"scenarios": scenarios})
            self.cases = list(self._build_cases())
        self.bases = list({case.base.scenario.name: case.base for case in self.cases}.values())

    @property
    def expected(self) -> int:
        searches = [case.search for case in self.cases]
        probes = sum(search.probes_left + len(search.outcomes) for search in searches)
        return probes * self._runs_per_probe

    def first(self) -> Iterable[Run]:
        return [run for case in range(len(self.cases)) for run in self._next_probe(case)]

    def follow(self, run: Run, values: Row) -> Iterable[Run]:
        index, steps = map(int, run.point.split("-")[:2])
        case = self.cases[index]
        rows = case.rows.setdefault(steps, [])
        rows.append(values)
        if len(rows) < self._runs_per_probe:
            return ()
        case.search.outcomes[steps] = all(held(row) for row in rows)
        return self._next_probe(index)

    def findings(self, _rows: list[Row]) -> dict[str, Any]:
        return {
            "quantity": self.definition.quantity,
            "title": self._quantity.title,
            "unit": self._quantity.unit,
            "resolution": self._resolution,
            "limit": self._limit,
            "completed": all(case.search.next() is None for case in self.cases),
            "offsets": self.definition.offsets,
            "duration_s": {base.scenario.name: base.scenario.duration_s for base in self.bases},
            "cases": [self._case_summary(case) for case in self.cases],
        }

    @property
    def _runs_per_probe(self) -> int:
        return len(self.definition.seeds) * len(self.definition.offsets)

    def _build_cases(self) -> Iterator[Case]:
        """All cases, each checked from every start at the largest value."""
        wanted = self.definition
        fixed = wanted.fixed_overrides
        if wanted.duration_s is not None:
            fixed = (*fixed, override("duration_s", wanted.duration_s))
        first = max(1, round(self._quantity.first / self._resolution))
        limit = max(1, round(self._limit / self._resolution))
        compensations: Sequence[bool | None] = wanted.compensation or [None]
        chosen = itertools.product(wanted.scenarios, wanted.laws, compensations)
        for scenario, law, compensation in chosen:
            overrides = (*fixed, override("controller.law", law))
            if compensation is not None:
                key = "controller.delay_compensation.enabled"
                overrides = (*overrides, override(key, compensation))
            base = load_setup(scenario, overrides)
            search = MarginSearch(min(first, limit), limit)
            case = Case(scenario, base, law, compensation, overrides, search)
            for scale in wanted.offsets:
                load_setup(scenario, self._overrides(case, self._limit, scale))
            yield case

    def _overrides(self, case: Case, value: float, offset_scale: float) -> tuple[str, ...]:
        offset = (offset_scale * case.base.scenario.robot.initial_offset_rad).tolist()
        start = override("robot.initial_offset_rad", offset)
        return (*case.overrides, *self._quantity.overrides(value), start)

    def _value(self, steps: int) -> float:
        return round(steps * self._resolution, 9)

    def _next_probe(self, index: int) -> list[Run]:
        case = self.cases[index]
        steps = case.search.next()
        if steps is None:
            return []
        value, runs = self._value(steps), []
        for start, scale in enumerate(self.definition.offsets):
            columns = {"arm": case.base.scenario.name, "compensation": case.compensation,
                       "quantity": self.definition.quantity, "value": value,
                       "offset_scale": scale}  # fmt: skip
            overrides = self._overrides(case, value, scale)
            runs += [
                Run(_point(index, steps, start), case.scenario, overrides, seed, columns)
                for seed in self.definition.seeds
            ]
        return runs

    def _case_summary(self, case: Case) -> dict[str, Any]:
        search = case.search
        probes = {
            steps: sorted(rows, key=lambda row: (row["point"], row["seed"]))
            for steps, rows in sorted(case.rows.items())
        }

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
                for steps, of_probe in probes.items()
            ],
        }


def _badness(row: Row) -> tuple[bool, float]:
    """What the worst of several runs has most of: failure, then ticks outside its bounds."""
    return row["error"] is not None, row["violation_fraction"] or 0.0


def _point(case: int, steps: int, start: int) -> str:
    """Name of a point: case, value and start, so that names sort as they are searched."""
    return f"{case:03d}-{steps:06d}-{start:02d}"

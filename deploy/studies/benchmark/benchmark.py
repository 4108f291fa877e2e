"""The benchmark: every cell at rising delays, on networks and as uncertain plants."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from operator import itemgetter
from pathlib import Path
from types import MappingProxyType
from typing import Any

from bus_schema.configuration import ConfigurationError, shown
from deploy.judge.conditions import Conditions
from deploy.judge.run_rows import Row, held, reason_of, tolerated
from deploy.reports.studies.study_result import Share
from deploy.scenario import study_keys
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import naming, override, validated
from deploy.studies.benchmark.cells import (
    CONSTANT,
    NETWORK,
    NO_PREDICTOR,
    PATTERN,
    PLANTS,
    PREDICTOR,
    BenchmarkDefinition,
    Cell,
    cells_of,
    places_of,
)
from deploy.studies.benchmark.result import BenchmarkResult, CellResult, PlantsKept
from deploy.study.definition import scenario_name
from deploy.study.losses import share_kept
from deploy.study.planned_run import PlannedRun
from deploy.study.plants import draw_columns, with_ranges
from deploy.study.settings import COMPENSATION
from deploy.study.statistics import kept_up_to
from deploy.study.study import StudyOfRuns, rows_by

_CELLS_FILE = "cells.csv"


def _gains_growth(key: str, old: Any, new: Any) -> Iterator[str]:
    """Gains of further laws and arms may be added; the others stay."""
    for arm, laws in (old or {}).items():
        for law, before in laws.items():
            now = (new or {}).get(arm, {}).get(law)
            if now != before:
                where = f"{key} of {law} on {arm}"
                yield f"{where} = {shown(now)}: must be {shown(before)}, as before"


class Benchmark(StudyOfRuns):
    """The runs of a benchmark.

    A cell begins with the smallest delay. If that is lost, it has no further runs.
    """

    kind = "benchmark"
    growth = MappingProxyType({**StudyOfRuns.growth, "gains": _gains_growth})
    definition: BenchmarkDefinition

    def __init__(self, values: Mapping[str, Any], source: Path) -> None:
        values = {"name": "benchmark", "uncertainty": "half", **values}
        given = validated(with_ranges(values, source), BenchmarkDefinition, source)
        with naming(source):
            if given.delays_ms != sorted(given.delays_ms):
                raise ConfigurationError("delays_ms", given.delays_ms, "must rise")
            own = {
                study_keys.LAW: "as laws",
                study_keys.SEED: "as seeds",
                PREDICTOR: "as predictors",
            }
            own |= {COMPENSATION: "as predictors"} | dict.fromkeys(study_keys.DELAYS, "as delays")
            study_keys.require_effect(given.fixed, own)
            names = [scenario_name(each, source.parent) for each in given.scenarios]
        self.definition = given.model_copy(update={"scenarios": names})
        self.cells = cells_of(self.definition)
        self.columns = {
            "arm": "string", "law": "string", "predictor": "string", "gains": "string",
            "condition": "string", "round_trip_ms": "double", "pattern": "string",
            "network": "string", "window": "double",
        }  # fmt: skip
        with naming(source):
            self._variants = [load_setup(each.scenario, self._common(each)) for each in self.cells]
            cells = list(zip(self.cells, self._variants, strict=True))
            self.bases = list({cell.scenario: setup for cell, setup in cells}.values())
            self.columns |= draw_columns(self.definition, self.bases)
            # Laws and gains of an arm share its places, whose plants take long to draw.
            kinds = [(cell.scenario, cell.predictor == NO_PREDICTOR) for cell in self.cells]
            of_kind = {
                kind: places_of(self.definition, setup, cell)
                for kind, (cell, setup) in dict(zip(kinds, cells, strict=True)).items()
            }
            self._places = [of_kind[kind] for kind in kinds]
        self._require_usable_places()
        self._left_out = 0

    def _require_usable_places(self) -> None:
        """Load the places of one cell of each arm, with the largest delay where it is varied.

        Raises:
            ScenarioError: a place cannot be used on an arm.
        """
        delays = [override(key, 0.5 * self.definition.delays_ms[-1]) for key in study_keys.DELAYS]
        of_arms = {cell.scenario: index for index, cell in reversed(list(enumerate(self.cells)))}
        for arm, index in of_arms.items():
            common = self._common(self.cells[index])
            with naming(Path(arm)):
                for place in {str(each.overrides): each for each in self._places[index]}.values():
                    own = (*place.overrides, *delays) if place.has_delays else place.overrides
                    load_setup(arm, [*common, *own])

    @property
    def unit(self) -> str:
        return "ms"

    @property
    def own_test(self) -> dict[str, Any]:
        return {**super().own_test, "delays_ms": self.definition.delays_ms}

    @property
    def variants(self) -> list[Setup]:
        return self._variants

    def _common(self, cell: Cell) -> tuple[str, ...]:
        found = self.definition.gains.get(cell.scenario, {}).get(cell.law, {})
        lasting = override("duration_s", self.definition.duration_s)
        from_s = override("metrics.from_s", min(2.0, 0.5 * self.definition.duration_s))
        return (*cell.overrides(found), lasting, from_s, *self.definition.fixed_overrides)

    @property
    def expected(self) -> int:
        return sum(map(self._runs_of, range(len(self.cells)))) - self._left_out

    def _runs_of(self, index: int) -> int:
        delays = len(self.definition.delays_ms)
        places = sum(delays if place.has_delays else 1 for place in self._places[index])
        return len(self.definition.seeds) * places

    def first(self) -> Iterable[PlannedRun]:
        return [run for index in range(len(self.cells)) for run in self._run(index, 0, 0)]

    def follow(self, run: PlannedRun, values: Row) -> Iterable[PlannedRun]:
        index, number, at = map(int, run.point.split("-"))
        place = self._places[index][number]
        if not tolerated(values):
            later = len(self.definition.delays_ms) - at - 1 if place.has_delays else 0
            others = self._runs_of(index) // len(self.definition.seeds) - at - 1
            self._left_out += others if number == at == 0 else later
            return
        if place.has_delays and at + 1 < len(self.definition.delays_ms):
            yield from self._run(index, number, at + 1, run.seed)
        if number == at == 0:
            for other in range(1, len(self._places[index])):
                yield from self._run(index, other, 0, run.seed)

    def _run(
        self, index: int, number: int, at: int, seed: int | None = None
    ) -> Iterator[PlannedRun]:
        """Yield a run of a place at a delay, with one seed, or with all."""
        cell, place = self.cells[index], self._places[index][number]
        delay_ms = self.definition.delays_ms[at] if place.has_delays else None
        half_ms = 0.5 * (delay_ms or 0.0)
        delays = [override(key, half_ms) for key in study_keys.DELAYS if place.has_delays]
        columns = {
            **dict.fromkeys(self.columns), **place.columns,
            "arm": cell.scenario, "law": cell.law, "predictor": cell.predictor, "gains": cell.gains,
            "condition": place.condition, "round_trip_ms": delay_ms,
        }  # fmt: skip
        for each in self.definition.seeds if seed is None else [seed]:
            yield PlannedRun(
                f"{index:04d}-{number:03d}-{at:02d}", cell.scenario,
                (*self._common(cell), *place.overrides, *delays),
                each + place.window * max(self.definition.seeds),
                columns, ends_early=bool(number or at),
            )  # fmt: skip

    def findings(self, rows: list[Row]) -> dict[str, Any]:
        by_cell, wanted = rows_by(rows, lambda row: row["point"].partition("-")[0]), self.definition
        return BenchmarkResult(
            completed=len(rows) >= self.expected, runs_expected=self.expected,
            delays_ms=wanted.delays_ms, networks=wanted.networks, windows=wanted.windows,
            plants=wanted.plants, plant_seed=wanted.plant_seed,
            cells=[self._found(self.cells[int(i)], own) for i, own in sorted(by_cell.items())],
        ).to_json()  # fmt: skip

    def _found(self, cell: Cell, rows: list[Row]) -> CellResult:
        of = {
            condition: [row for row in rows if row["condition"] == condition]
            for condition in (CONSTANT, PATTERN, NETWORK, PLANTS)
        }
        first = [row for row in of[CONSTANT] if row["point"].endswith("-00")]
        patterns, networks, plants = (
            rows_by(of[condition], itemgetter(column))
            for condition, column in ((PATTERN, "pattern"), (NETWORK, "network"), (PLANTS, "plant"))
        )
        margin_ms, kept_ms = (
            self._kept_up_to(of[CONSTANT]), list(map(self._kept_up_to, plants.values()))
        )  # fmt: skip
        return CellResult(
            **dict(cell), margin_ms=margin_ms,
            any_pattern_ms=min([margin_ms, *map(self._kept_up_to, patterns.values())]),
            rms_rad=_mean_of(first, "rms_rad"),
            travel_nm_per_s=_mean_of(first, "total_variation_nm_per_s"),
            losses=dict(Counter(filter(None, map(reason_of, first)))),
            networks={
                name: Share(**share_kept(sum(map(held, networks[name])), len(networks[name])))
                for name in self.definition.networks if name in networks
            },
            plants_kept=[
                PlantsKept(
                    round_trip_ms=each_ms,
                    **share_kept(sum(kept >= each_ms for kept in kept_ms), len(kept_ms)),
                )
                for each_ms in self.definition.delays_ms if kept_ms
            ],
        )  # fmt: skip

    def _kept_up_to(self, rows: list[Row]) -> float:
        """Return the largest delay up to which all runs were kept; 0 for none."""
        return kept_up_to(rows, "round_trip_ms", self.definition.delays_ms, tolerated) or 0.0

    def keep_files(self, summary: dict[str, Any], folder: Path) -> None:
        """Write a table with a line for each cell."""
        result = BenchmarkResult.model_validate(summary)
        with (folder / _CELLS_FILE).open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            measures = ["margin_ms", "any_pattern_ms", "worst_rms_rad", "worst_travel_nm_per_s"]
            names = [*Cell.model_fields, *measures]
            writer.writerow([*names, *(f"kept_{network}" for network in result.networks)])
            for cell in result.cells:
                values = (getattr(cell, name) for name in names)
                writer.writerow([*values, *map(cell.fraction, result.networks)])
        summary["files"] = [_CELLS_FILE]

    def conditions(self, summary: Mapping[str, Any], manifest: Mapping[str, Any]) -> Conditions:
        wanted = self.definition
        delays = ", ".join(f"{each:g}" for each in wanted.delays_ms)
        axes = [{"keys": ["round trip"], "values": [f"{delays} ms, until the first loss"]}]
        tuned = {f"{law} on {arm}" for arm, laws in wanted.gains.items() for law in laws}
        return {
            **super().conditions({**summary, "axes": axes}, manifest),
            "arm": "encoders of 20 bits, unless given",
            "networks": ", ".join(wanted.networks) or "none",
            "windows": f"{wanted.windows} of each network",
            "tuned": ", ".join(sorted(tuned)) or "nothing: gains of the scenario, or derived",
        }


def _mean_of(rows: list[Row], column: str) -> list[float] | None:
    """Return the mean of seeds, for each joint; None if a run has no value."""
    values = [row[column] for row in rows]
    if not values or any(each is None for each in values):
        return None
    return [sum(of_joint) / len(values) for of_joint in zip(*values, strict=True)]

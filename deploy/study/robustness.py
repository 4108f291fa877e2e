"""Margins over uncertain plants: at each value, the share of plants that keep their bounds."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from bus_schema.configuration import Number, Whole
from deploy.runs.run_rows import Row
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.uncertainty import Uncertainty
from deploy.scenario.yaml_files import ScenarioError, naming, plain, validated
from deploy.study.cases import (
    CASE_COLUMNS,
    CasesDefinition,
    Setting,
    bases_of,
    scenarios_of,
    settings,
)
from deploy.study.held_arm import ceiling_of_value
from deploy.study.losses import rank_losses, share_kept
from deploy.study.margin import Margin, MarginDefinition
from deploy.study.plants import (
    Plant,
    UncertainDefinition,
    draw_columns,
    draw_plants,
    measured,
    refused,
    uncertainty_of,
    with_ranges,
)
from deploy.study.statistics import badness, held, spread_of_runs
from deploy.study.study import Different, Run, Seeds, Study

_WORST_POINTS = 3


class RobustnessDefinition(CasesDefinition, UncertainDefinition):
    """What to try on many plants, as a study's YAML file has it.

    Attributes:
        plants: how many are drawn; all of them meet every value under every law.
        values: of the quantity.
        kept_share: share of the plants that have to keep their bounds for a value to count as
            taken.
        seeds: a plant keeps its bounds at a value if it does with every seed.
    """

    plants: Annotated[Whole, Field(ge=1, le=1000)]
    values: Annotated[Different[Number], Field(min_length=1)]
    kept_share: Annotated[Number, Field(gt=0, le=1)] = 0.95
    seeds: Seeds = Field(default=[1])


@dataclass(frozen=True)
class _Case:
    """A setting, what is drawn for it, its plants, and how long each may be held at first, ms."""

    setting: Setting
    uncertainty: Uncertainty
    plants: list[Plant]
    ceilings_ms: list[float | None]


class Robustness(Study):
    """The runs of all plants at all values.

    Attributes:
        cases: what is tried.
    """

    kind = "robustness"
    definition: RobustnessDefinition

    def __init__(self, values: Mapping[str, Any], source: Path) -> None:
        with naming(source):
            ranged = with_ranges(values, source)
        given = validated(ranged, RobustnessDefinition, source)
        with naming(source):
            changes = {"scenarios": scenarios_of(given, source), "values": sorted(given.values)}
            self.definition = given.model_copy(update=changes)
            self.cases = list(self._build_cases())
        self.bases = bases_of([case.setting for case in self.cases])
        self.columns = {**CASE_COLUMNS, **draw_columns(self.definition, self.bases)}

    @property
    def expected(self) -> int:
        wanted = self.definition
        return len(self.cases) * len(wanted.values) * wanted.plants * len(wanted.seeds)

    def first(self) -> Iterable[Run]:
        wanted = self.definition
        for index, case in enumerate(self.cases):
            for at, value in enumerate(wanted.values):
                tags = {**case.setting.tags, "quantity": wanted.quantity, "value": value}
                for plant in case.plants:
                    overrides = case.setting.at(value, plant.overrides)
                    point, columns = _point(index, at, plant), {**tags, **plant.columns}
                    for seed in wanted.seeds:
                        yield Run(point, case.setting.scenario, overrides, seed, columns)

    def findings(self, rows: list[Row]) -> dict[str, Any]:
        wanted, quantity = self.definition, self.cases[0].setting.quantity
        by_point: dict[str, list[Row]] = {}
        for row in rows:
            by_point.setdefault(row["point"], []).append(row)
        return {
            "quantity": wanted.quantity,
            "title": quantity.title,
            "unit": quantity.unit,
            "values": wanted.values,
            "plants": wanted.plants,
            "plant_seed": wanted.plant_seed,
            "kept_share": wanted.kept_share,
            "completed": len(rows) == self.expected,
            "duration_s": {base.scenario.name: base.scenario.duration_s for base in self.bases},
            "uncertainty": {
                base.scenario.name: plain(uncertainty_of(wanted, base)) for base in self.bases
            },
            "cases": [
                self._case_summary(index, case, by_point) for index, case in enumerate(self.cases)
            ],
        }

    def _build_cases(self) -> Iterator[_Case]:
        """All cases; each scenario is checked with every plant, each case with the first."""
        wanted, ceilings = self.definition, dict[str, list[float | None]]()
        for setting in settings(wanted):
            plants = draw_plants(wanted, setting.base, setting.quantity.keys)
            known = f"{setting.scenario} {setting.running}"
            if known not in ceilings:
                setups = [self._checked(setting, plant) for plant in plants]
                ceilings[known] = [self._ceiling(setting, setup) for setup in setups]
            self._checked(setting, plants[0])
            uncertainty = uncertainty_of(wanted, setting.base)
            yield _Case(setting, uncertainty, plants, ceilings[known])

    def _checked(self, setting: Setting, plant: Plant) -> Setup:
        overrides = setting.at(self.definition.values[-1], plant.overrides)
        try:
            return load_setup(setting.scenario, overrides)
        except ScenarioError as error:
            raise refused(plant, error) from error

    def _ceiling(self, setting: Setting, setup: Setup) -> float | None:
        if setting.running or self.definition.quantity != "delay":
            return None
        return ceiling_of_value(setup, self.definition.direction)

    def _case_summary(
        self, index: int, case: _Case, by_point: Mapping[str, list[Row]]
    ) -> dict[str, Any]:
        found, lost = [], []
        for at, value in enumerate(self.definition.values):
            points = [_point(index, at, plant) for plant in case.plants]
            judged = [rows for point in points if self._is_judged(rows := by_point.get(point, []))]
            found.append({"value": value, **_value_summary(value, case, judged)})
            if len(judged) == len(points):
                lost.append([not _is_kept(rows) for rows in judged])
        quantities = measured(case.uncertainty, case.plants, case.setting.base)
        return {
            "law": case.setting.law,
            **case.setting.tags,
            "kept_up_to": self._kept_up_to(found),
            "held_arm_ceiling_ms": min(_known(case.ceilings_ms), default=None),
            "values": found,
            "losses": rank_losses(
                quantities, np.array(lost, dtype=bool).reshape(-1, len(case.plants))
            ),
        }

    def _is_judged(self, rows: list[Row]) -> bool:
        return len(rows) == len(self.definition.seeds)

    def _kept_up_to(self, found: list[dict[str, Any]]) -> float | None:
        """The largest value up to which enough plants are kept at every one, all plants judged."""
        largest = None
        for one in found:
            enough = one["kept"] >= self.definition.kept_share * self.definition.plants
            if one["total"] < self.definition.plants or not enough:
                break
            largest = one["value"]
        return largest


def margin_study(values: Mapping[str, Any], source: Path) -> Study:
    """Margins by search, or with ``plants`` the shares of uncertain plants at given values.

    Args:
        values: the definition, as its YAML file has it.
        source: that file.

    Raises:
        ScenarioError: it cannot be used, or mixes the two.
    """
    of_many = values.get("plants") is not None
    of_search, of_plants = (set(m.model_fields) for m in (MarginDefinition, RobustnessDefinition))
    for key in sorted(
        values.keys() & (of_search - of_plants if of_many else of_plants - of_search)
    ):
        allowed = f"must be left out {'with' if of_many else 'without'} plants"
        raise ScenarioError(f"{source}: {key} = {values[key]!r}: {allowed}")
    return Robustness(values, source) if of_many else Margin(values, source)


def _value_summary(value: float, case: _Case, judged: list[list[Row]]) -> dict[str, Any]:
    """What became of the plants at one value: a list of rows for each that is judged."""
    kept = sum(map(_is_kept, judged))
    worst = sorted(judged, key=lambda rows: max(map(badness, rows)), reverse=True)[:_WORST_POINTS]
    return {
        **share_kept(kept, len(judged)),
        "beyond_held_arm_ceiling": sum(value >= c for c in _known(case.ceilings_ms)),
        "worst_points": [rows[0]["point"] for rows in worst],
        **spread_of_runs([row for rows in judged for row in rows]),
    }


def _is_kept(rows: list[Row]) -> bool:
    return all(held(row) for row in rows)


def _known(values: Iterable[float | None]) -> list[float]:
    return [value for value in values if value is not None]


def _point(case: int, value: int, plant: Plant) -> str:
    """Name of a point: case, value and plant, so that names sort as they are asked for."""
    return f"{case:03d}-{value:03d}-{plant.number:04d}"

"""Margins over uncertain plants: at each value, the share of plants that keep their bounds."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, Field

from bus_schema.configuration import Number, Whole
from deploy.judge.run_rows import Row, held, left_nothing
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.study_keys import LAW, SEED, UNCERTAINTY, require_effect, seeds_that_differ
from deploy.scenario.uncertainty import Uncertainty
from deploy.scenario.yaml_files import ScenarioError, plain
from deploy.study.cases import (
    CASE_COLUMNS,
    Case,
    CasesDefinition,
    Setting,
    StudyOfCases,
    settings,
)
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
)
from deploy.study.statistics import badness, spread_of_runs
from deploy.study.study import Different, PlannedRun, Seeds, StudyOfRuns

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
    values: Annotated[Different[Number], Field(min_length=1), AfterValidator(sorted)]
    kept_share: Annotated[Number, Field(gt=0, le=1)] = 0.95
    seeds: Seeds = Field(default=[1])


@dataclass
class _Plants(Case):
    """The plants of a setting.

    Attributes:
        uncertainty: what is drawn.
        plants: the plants.
        seeds: those of the runs of each: one is enough where nothing is random.
    """

    uncertainty: Uncertainty
    plants: list[Plant]
    seeds: list[list[int]]


class Robustness(StudyOfCases[_Plants]):
    """The runs of all plants at all values."""

    kind = "robustness"
    definition_type = RobustnessDefinition
    definition: RobustnessDefinition

    def __init__(self, values: Mapping[str, Any], source: Path) -> None:
        super().__init__(values, source)
        self.columns = {**CASE_COLUMNS, **draw_columns(self.definition, self.bases)}

    @property
    def expected(self) -> int:
        runs_per_value = sum(len(seeds) for case in self.cases for seeds in case.seeds)
        return len(self.definition.values) * runs_per_value

    def first(self) -> Iterable[PlannedRun]:
        for index, case in enumerate(self.cases):
            for at, value in enumerate(self.definition.values):
                for plant, seeds in zip(case.plants, case.seeds, strict=True):
                    yield from self.planned(
                        _point(index, at, plant), case.setting, value, seeds,
                        plant.overrides, plant.columns,
                    )  # fmt: skip

    def case_findings(self, rows: list[Row]) -> dict[str, Any]:
        wanted = self.definition
        by_point: dict[str, list[Row]] = {}
        for row in rows:
            by_point.setdefault(row["point"], []).append(row)
        return {
            "values": wanted.values,
            "plants": wanted.plants,
            "plant_seed": wanted.plant_seed,
            "kept_share": wanted.kept_share,
            "completed": len(rows) == self.expected and not any(map(left_nothing, rows)),
            "uncertainty": {
                base.scenario.name: plain(uncertainty_of(wanted, base)) for base in self.bases
            },
            "cases": [
                self._case_summary(index, case, by_point) for index, case in enumerate(self.cases)
            ],
        }

    def build_cases(self) -> Iterator[_Plants]:
        # Each scenario is checked with every plant, each case with the first.
        wanted, known = self.definition, dict[str, tuple[list[float], list[list[int]]]]()
        given = wanted.uncertainty is not None
        for setting in settings(wanted, {UNCERTAINTY: "as --uncertainty"} if given else {}):
            keys = setting.quantity.keys
            require_effect(wanted.fixed, dict.fromkeys(keys, "as quantity and values"))
            plants = draw_plants(wanted, setting.base, [*keys, LAW, SEED])
            of = f"{setting.scenario} {setting.running}"
            if of not in known:
                setups = [self._checked(setting, plant) for plant in plants]
                known[of] = (
                    self.ceilings_ms(setting, setups),
                    [seeds_that_differ(setup, wanted.seeds) for setup in setups],
                )
            self._checked(setting, plants[0])
            ceilings, seeds = known[of]
            uncertainty = uncertainty_of(wanted, setting.base)
            yield _Plants(setting, ceilings, uncertainty, plants, seeds)

    def _checked(self, setting: Setting, plant: Plant) -> Setup:
        overrides = setting.at(self.definition.values[-1], plant.overrides)
        try:
            return load_setup(setting.scenario, overrides)
        except ScenarioError as error:
            raise refused(plant, error) from error

    def _case_summary(
        self, index: int, case: _Plants, by_point: Mapping[str, list[Row]]
    ) -> dict[str, Any]:
        found, lost = [], []
        for at, value in enumerate(self.definition.values):
            points = [_point(index, at, plant) for plant in case.plants]
            judged = [
                rows
                for point, seeds in zip(points, case.seeds, strict=True)
                if len(rows := by_point.get(point, [])) == len(seeds)
                and not any(map(left_nothing, rows))
            ]
            found.append({"value": value, **_value_summary(value, case, judged)})
            if len(judged) == len(points):
                lost.append([not _is_kept(rows) for rows in judged])
        quantities = measured(case.uncertainty, case.plants, case.setting.base)
        return {
            **case.setting.tags,
            "kept_up_to": self._kept_up_to(found),
            "held_arm_ceiling_ms": min(case.ceilings_ms, default=None),
            "values": found,
            "losses": rank_losses(
                quantities, np.array(lost, dtype=bool).reshape(-1, len(case.plants))
            ),
        }

    def _kept_up_to(self, found: list[dict[str, Any]]) -> float | None:
        """The largest value up to which enough plants are kept at every one, all plants judged."""
        largest = None
        for one in found:
            enough = one["kept"] >= self.definition.kept_share * self.definition.plants
            if one["total"] < self.definition.plants or not enough:
                break
            largest = one["value"]
        return largest


def margin_study(values: Mapping[str, Any], source: Path) -> StudyOfRuns:
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


def _value_summary(value: float, case: _Plants, judged: list[list[Row]]) -> dict[str, Any]:
    """What became of the plants at one value: a list of rows for each that is judged."""
    kept = sum(map(_is_kept, judged))
    worst = sorted(judged, key=lambda rows: max(map(badness, rows)), reverse=True)[:_WORST_POINTS]
    return {
        **share_kept(kept, len(judged)),
        "beyond_held_arm_ceiling": sum(value >= c for c in case.ceilings_ms),
        "worst_points": [rows[0]["point"] for rows in worst],
        **spread_of_runs([row for rows in judged for row in rows]),
    }


def _is_kept(rows: list[Row]) -> bool:
    return all(held(row) for row in rows)


def _point(case: int, value: int, plant: Plant) -> str:
    """Name of a point: case, value and plant, so that names sort as they are asked for."""
    return f"{case:03d}-{value:03d}-{plant.number:04d}"

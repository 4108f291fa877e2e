"""Margins over uncertain plants: at each value, the share of plants that keep their bounds."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, Field

from bus_schema.configuration import Number, Whole
from deploy.judge.run_rows import Row, held, left_nothing
from deploy.scenario.study_keys import LAW, SEED, UNCERTAINTY, require_effect
from deploy.scenario.yaml_files import ScenarioError, plain
from deploy.study import cases, plants
from deploy.study.losses import rank_losses, share_kept
from deploy.study.margin import Margin, MarginDefinition
from deploy.study.statistics import badness, spread_of_runs
from deploy.study.study import Different, PlannedRun, Seeds, StudyOfRuns, rows_by

_WORST_POINTS = 3


class RobustnessDefinition(cases.CasesDefinition, plants.UncertainDefinition):
    """Trials on many plants, as in a study's YAML file.

    Attributes:
        plants: number of drawn plants; each one is tried at every value with every law.
        values: values of the quantity.
        kept_share: share of the plants that must keep their bounds for a value to count as
            tolerated.
        seeds: a plant keeps its bounds at a value if it does with every seed.
    """

    plants: Annotated[Whole, Field(ge=1, le=1000)]
    values: Annotated[Different[Number], Field(min_length=1), AfterValidator(sorted)]
    kept_share: Annotated[Number, Field(gt=0, le=1)] = 0.95
    seeds: Seeds = Field(default=[1])


class Robustness(cases.StudyOfCases):
    """The runs of all plants at all values."""

    kind = "robustness"
    definition_type = RobustnessDefinition
    definition: RobustnessDefinition

    def __init__(self, values: Mapping[str, Any], source: Path) -> None:
        super().__init__(values, source)
        self.columns = {**cases.CASE_COLUMNS, **plants.draw_columns(self.definition, self.bases)}

    @property
    def own_keys(self) -> dict[str, str]:
        is_given = self.definition.uncertainty is not None
        return {UNCERTAINTY: "as --uncertainty"} if is_given else {}

    def last_value(self, _setting: cases.Setting) -> float:
        return self.definition.values[-1]

    def variants_of(self, setting: cases.Setting) -> list[plants.Variant]:
        keys = setting.quantity.keys
        require_effect(self.definition.fixed, dict.fromkeys(keys, "as quantity and values"))
        return plants.draw_plants(self.definition, setting.base, [*keys, LAW, SEED])

    def first(self) -> Iterable[PlannedRun]:
        for index in range(len(self.cases)):
            for at, value in enumerate(self.definition.values):
                yield from self.runs_at(index, at, value)

    def case_findings(self, rows: list[Row]) -> dict[str, Any]:
        wanted, by_point = self.definition, rows_by(rows, lambda row: row["point"])
        return {
            "values": wanted.values,
            "plants": wanted.plants,
            "plant_seed": wanted.plant_seed,
            "kept_share": wanted.kept_share,
            "completed": len(rows) == self.expected and not any(map(left_nothing, rows)),
            "uncertainty": {
                base.scenario.name: plain(plants.uncertainty_of(wanted, base))
                for base in self.bases
            },
            "cases": [
                self._case_findings(index, case, by_point) for index, case in enumerate(self.cases)
            ],
        }

    def _case_findings(
        self, index: int, case: cases.Case, by_point: Mapping[str, list[Row]]
    ) -> dict[str, Any]:
        found, lost = [], []
        for at, value in enumerate(self.definition.values):
            tried = [
                by_point.get(cases.point_name(index, at, plant), []) for plant in case.variants
            ]
            judged = [
                rows
                for rows, seeds in zip(tried, case.seeds, strict=True)
                if len(rows) == len(seeds) and not any(map(left_nothing, rows))
            ]
            found.append({"value": value, **_value_summary(value, case, judged)})
            if len(judged) == len(tried):
                lost.append([not _is_kept(rows) for rows in judged])
        base = case.setting.base
        quantities = plants.measured(
            plants.uncertainty_of(self.definition, base), case.variants, base
        )
        was_lost = np.array(lost, dtype=bool).reshape(-1, len(case.variants))
        return {
            **case.findings,
            "kept_up_to": self._kept_up_to(found),
            "values": found,
            "losses": rank_losses(quantities, was_lost),
        }

    def _kept_up_to(self, found: list[dict[str, Any]]) -> float | None:
        """Return the largest value up to which enough plants were kept, with all plants judged."""
        largest = None
        for one in found:
            enough = one["kept"] >= self.definition.kept_share * self.definition.plants
            if one["total"] < self.definition.plants or not enough:
                break
            largest = one["value"]
        return largest


def margin_study(values: Mapping[str, Any], source: Path) -> StudyOfRuns:
    """Return margins by search, or with ``plants`` the shares of uncertain plants at given values.

    Args:
        values: the definition, in the form of its YAML file.
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


def _value_summary(value: float, case: cases.Case, judged: list[list[Row]]) -> dict[str, Any]:
    """Summarise the plants at one value, from a list of rows for each judged plant."""
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

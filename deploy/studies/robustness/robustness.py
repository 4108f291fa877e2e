"""Margins over uncertain plants: at each value, the share of plants that keep their bounds."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, Field

from bus_schema.configuration import Number, Whole
from deploy.judge.run_rows import Row, tolerated
from deploy.scenario.study_keys import LAW, SEED, UNCERTAINTY, require_effect
from deploy.scenario.yaml_files import plain
from deploy.study import cases, plants
from deploy.study.definition import Different, Seeds
from deploy.study.doubts import doubts
from deploy.study.losses import rank_losses, share_kept
from deploy.study.planned_run import PlannedRun
from deploy.study.settings import CasesDefinition, Setting
from deploy.study.statistics import badness, spread_of_runs
from deploy.study.trials.sequential_test import SequentialTest

_WORST_POINTS = 3


class RobustnessDefinition(CasesDefinition, plants.UncertainDefinition):
    """Trials on many plants, as in a study's YAML file.

    Attributes:
        plants: number of drawn plants. At every value with every law, so many are tried in order
            that their share is decided nearly as surely as by all of them.
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
    named_furthest = "the last value tried (--values)"

    def __init__(self, values: Mapping[str, Any], source: Path) -> None:
        super().__init__(values, source)
        self.columns = {**cases.CASE_COLUMNS, **plants.draw_columns(self.definition, self.bases)}
        self.test = SequentialTest(self.definition.kept_share, self.definition.plants)

    @property
    def own_keys(self) -> dict[str, str]:
        is_given = self.definition.uncertainty is not None
        return {UNCERTAINTY: "as --uncertainty"} if is_given else {}

    @property
    def own_test(self) -> dict[str, Any]:
        keys = ("plants", "plant_seed", "uncertainty", "values", "kept_share")
        return {**super().own_test, **self.definition.model_dump(include=set(keys), mode="json")}

    def last_value(self, _setting: Setting) -> float:
        return self.definition.values[-1]

    def variants_of(self, setting: Setting) -> list[plants.Variant]:
        keys = setting.quantity.keys
        require_effect(self.definition.fixed, dict.fromkeys(keys, "as quantity and values"))
        return plants.draw_plants(self.definition, setting.base, [*keys, LAW, SEED])

    def first(self) -> Iterable[PlannedRun]:
        for index, case in enumerate(self.cases):
            for at, value in enumerate(self.definition.values):
                yield from self.begin(self.runs_at(index, at, value, case.variants), self.test)

    @property
    def expected(self) -> int:
        if not self.trials:
            return len(self.cases) * len(self.definition.values) * self.definition.plants
        return sum(trial.expected for trial in self.all_trials)

    @property
    def at_most(self) -> int:
        if not self.trials:
            return self.expected * len(self.definition.seeds)
        return sum(trial.at_most for trial in self.all_trials)

    def case_findings(self, _rows: list[Row]) -> dict[str, Any]:
        wanted, trials = self.definition, self.all_trials
        is_begun = len(trials) == len(self.cases) * len(wanted.values)
        return {
            "values": wanted.values,
            "plants": wanted.plants,
            "plant_seed": wanted.plant_seed,
            "kept_share": wanted.kept_share,
            "test": None if wanted.is_exhaustive else self.test.error_probabilities,
            "completed": is_begun and all(trial.known.outcome is not None for trial in trials),
            "uncertainty": {
                base.scenario.name: plain(plants.uncertainty_of(wanted, base))
                for base in self.bases
            },
            "cases": [self._case_findings(index, case) for index, case in enumerate(self.cases)],
        }

    def _case_findings(self, index: int, case: cases.Case) -> dict[str, Any]:
        found, tried_rows = list[dict[str, Any]](), list[Row]()
        count = len(self.definition.values)
        lost = np.full((count, len(case.variants)), np.nan)
        for at, value in enumerate(self.definition.values):
            trial = self.trials.get(cases.point_name(index, at, case.variants[0]))
            judged = [] if trial is None else [rows for _, rows in trial.known.judged]
            outcome = None if trial is None else trial.known.outcome
            tried_rows += [] if trial is None else trial.rows.values()
            found.append({"value": value, **self._value_summary(value, case, judged, outcome)})
            if outcome is not None:
                lost[at, : len(judged)] = [not _is_kept(rows) for rows in judged]
        base = case.setting.base
        quantities = plants.measured(
            plants.uncertainty_of(self.definition, base), case.variants, base
        )
        return {
            **case.findings,
            "kept_up_to": _kept_up_to(found),
            "doubts": doubts(case.setting, tried_rows, self.columns),
            "values": found,
            "losses": rank_losses(quantities, lost),
        }

    def _value_summary(
        self, value: float, case: cases.Case, judged: list[list[Row]], outcome: bool | None
    ) -> dict[str, Any]:
        """Summarise the plants at one value, from a list of rows for each judged plant."""
        kept, total = sum(map(_is_kept, judged)), len(judged)
        worst = sorted(judged, key=lambda rows: max(map(badness, rows)), reverse=True)
        share = share_kept(kept, total)
        interval = share["wilson_95"]
        if not self.definition.is_exhaustive:  # which ends at any number of plants
            interval = None if outcome is None else list(self.test.interval(kept, total - kept))
        return {
            **share,
            "interval_95": interval,
            "tolerated": outcome,
            "beyond_held_arm_ceiling": sum(value >= c for c in case.ceilings_ms),
            "worst_points": [rows[0]["point"] for rows in worst[:_WORST_POINTS]],
            **spread_of_runs([row for rows in judged for row in rows]),
        }


def _kept_up_to(found: list[dict[str, Any]]) -> float | None:
    """Return the largest value up to which all values are tolerated."""
    tolerated = itertools.takewhile(lambda one: one["tolerated"], found)
    return max((one["value"] for one in tolerated), default=None)


def _is_kept(rows: list[Row]) -> bool:
    return all(map(tolerated, rows))

"""Cases: settings that have a margin, with the starts or plants that are tried in each."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar

from deploy.judge.conditions import Conditions
from deploy.judge.gate import Gauged
from deploy.judge.run_rows import Row, is_whole, uses_seed
from deploy.scenario import study_keys
from deploy.scenario.held_arm import held_arm_ceiling_ms
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import ScenarioError, naming, validated
from deploy.study.definition import require_own_names, scenario_name
from deploy.study.doubts import too_short
from deploy.study.execution.growth import may_be_added, may_change
from deploy.study.planned_run import PlannedRun
from deploy.study.plants import Variant, with_ranges
from deploy.study.quantities import EXCITATION
from deploy.study.settings import CasesDefinition, Setting, settings
from deploy.study.study import StudyOfRuns
from deploy.study.trials.sequential_test import SequentialTest
from deploy.study.trials.trial import Trial, runs_ahead, worst_first

CASE_COLUMNS = {
    "law": "string", "arm": "string", "compensation": "bool", "drive_feedback": "bool",
    "running": "bool", "quantity": "string", "value": "double",
}  # fmt: skip
"""Names and Parquet types of the columns that identify a run of margins, except its start."""


@dataclass(frozen=True)
class Case:
    """A setting, and the runs at every value of it.

    Attributes:
        setting: the setting.
        variants: starts or plants.
        ceilings_ms: how long each variant's arm may be held at its start, if known.
    """

    setting: Setting
    variants: list[Variant]
    ceilings_ms: list[float]

    @property
    def findings(self) -> dict[str, Any]:
        """Leading values of its summary."""
        ceiling = min(self.ceilings_ms, default=None)
        scale = self.setting.base.scenario.controller.model_scale
        return {**self.setting.tags, "held_arm_ceiling_ms": ceiling, "model_scale": scale}


class StudyOfCases(StudyOfRuns):
    """A study of a growing quantity, in all settings of its definition.

    Attributes:
        definition_type: schema of its YAML file.
        named_furthest: words for the last value that it tries, with the option that sets it.
        cases: the cases to try.
        trials: the trial of each variant at each value, by point.
    """

    growth = MappingProxyType({
        **StudyOfRuns.growth,
        **dict.fromkeys(("what_helps", "smaller_rotors"), may_change),
        **dict.fromkeys(("pattern", "disturbances"), may_be_added),
    })  # fmt: skip
    definition_type: ClassVar[type[CasesDefinition]]
    definition: Any
    named_furthest: ClassVar[str]
    cases: list[Case]
    _is_random = False
    """A run of it drew random numbers."""

    def __init__(self, values: Mapping[str, Any], source: Path) -> None:
        with naming(source):
            ranged = with_ranges(values, source)
        given = validated(ranged, self.definition_type, source)
        with naming(source):
            scenarios = [scenario_name(name, source.parent) for name in given.scenarios]
            self.definition = given.model_copy(update={"scenarios": scenarios})
            self.trials: dict[str, Trial] = {}
            self.cases = list(self._build_cases())
            require_own_names(
                (case.setting.base.scenario.name, case.setting.scenario) for case in self.cases
            )
            self.bases = list({base.scenario.name: base for base in self.variants}.values())
            study_keys.require_link_effect({**given.fixed, given.quantity: None}, self.bases)

    @abstractmethod
    def variants_of(self, setting: Setting) -> list[Variant]:
        """Return the starts or plants of a setting; raises as `settings`."""

    @abstractmethod
    def last_value(self, setting: Setting) -> float:
        """Return the last value to try; raises as `settings`."""

    @property
    def furthest(self) -> Gauged:
        """The last value that is tried in every case."""
        found = []
        for setting in (case.setting for case in self.cases):
            last, quantity = self.last_value(setting), setting.quantity
            sign = -1 if last < quantity.origin and not quantity.is_of_link else 1
            found.append(Gauged(self.named_furthest, last, quantity.unit, sign))
        return min(found, key=lambda each: each.sign * (each.value or 0.0))

    @property
    def doubts_before(self) -> list[str]:
        return list(dict.fromkeys(filter(None, (too_short(case.setting) for case in self.cases))))

    @property
    def own_test(self) -> dict[str, Any]:
        wanted = self.definition
        return {**super().own_test, "direction": wanted.direction, "excitation": wanted.excitation}

    @property
    @abstractmethod
    def own_keys(self) -> Mapping[str, str]:
        """Keys that it sets by itself, each with the alternative to use."""

    @abstractmethod
    def case_findings(self, rows: list[Row]) -> dict[str, Any]:
        """Return the results of the cases, and whether all is `completed`, ready for JSON."""

    def conditions(self, summary: Mapping[str, Any], manifest: Mapping[str, Any]) -> Conditions:
        found = super().conditions(summary, manifest)
        if self.definition.excitation and any(case.setting.tags["running"] for case in self.cases):
            found["excitation"] = EXCITATION
        saved = summary["saved"]
        early = saved["runs_ended_early"]
        ended = f", {early} ended at their loss" if early else ""
        found["runs"] = f"{summary['runs']} of {saved['runs_planned']} planned{ended}"
        return found

    def _build_cases(self) -> Iterator[Case]:
        """Return all cases; each arm is checked in every variant, each case in the first."""
        known = dict[str, list[float]]()
        for setting in settings(self.definition, self.own_keys):
            variants = self.variants_of(setting)
            arm = f"{setting.scenario} {setting.tags['running']}"
            if arm in known:
                self._checked(setting, variants[0])
            else:
                setups = [self._checked(setting, variant) for variant in variants]
                known[arm] = self._ceilings_ms(setting, setups)
            yield Case(setting, variants, known[arm])

    def _checked(self, setting: Setting, variant: Variant) -> Setup:
        overrides = setting.of(self.last_value(setting), variant)
        try:
            return load_setup(setting.scenario, overrides)
        except ScenarioError as error:
            raise variant.refused(error) from error

    def _ceilings_ms(self, setting: Setting, setups: Iterable[Setup]) -> list[float]:
        """Return the held-arm ceilings of a delay that acts from the start, if any."""
        if setting.tags["running"] or self.definition.quantity != "delay":
            return []
        found = (held_arm_ceiling_ms(setup, self.definition.direction) for setup in setups)
        return [each for each in found if each is not None]

    @property
    def variants(self) -> list[Setup]:
        return [case.setting.base for case in self.cases]

    @property
    def unit(self) -> str:
        return self.cases[0].setting.quantity.unit

    def findings(self, rows: list[Row]) -> dict[str, Any]:
        quantity = self.cases[0].setting.quantity
        return {
            "quantity": self.definition.quantity,
            "title": quantity.title,
            "unit": quantity.unit,
            "duration_s": {base.scenario.name: base.scenario.duration_s for base in self.bases},
            **self.case_findings(rows),
            "saved": self._saved(rows),
        }

    def _saved(self, rows: list[Row]) -> dict[str, Any]:
        """Return how much less was run than all variants and seeds at all tried values."""
        durations_s = {base.scenario.name: base.scenario.duration_s for base in self.bases}
        planned_s = sum(
            trial.planned * durations_s[trial.runs[0].columns["arm"]] for trial in self.all_trials
        )
        return {
            "runs_planned": sum(trial.planned for trial in self.all_trials),
            "runs_ended_early": sum(not is_whole(row) for row in rows),
            "planned_s": planned_s,
            "simulated_s": math.fsum(row.get("duration_s") or 0.0 for row in rows),
        }

    @property
    def runs_per_variant(self) -> int:
        """Number of runs of a variant at a value, as far as known now."""
        return len(self.definition.seeds) if self._is_random else 1

    def begin(
        self, runs: Iterable[PlannedRun], test: SequentialTest, earlier: Iterable[Row] = (),
        *, is_exhaustive: bool = False,
    ) -> list[PlannedRun]:  # fmt: skip
        """Begin the trial of some variants at a value; return the first runs.

        Args:
            runs: a run of each variant, in order.
            test: decides the value.
            earlier: rows at other values, by which the worst variants and seeds go first.
            is_exhaustive: make all runs, and to their ends.
        """
        is_exhaustive |= self.definition.is_exhaustive
        planned = [replace(run, ends_early=not is_exhaustive) for run in runs]
        planned, seeds = worst_first(
            planned, self.definition.seeds, () if is_exhaustive else earlier
        )
        trial = Trial(test, planned, seeds, is_exhaustive)
        self.trials |= dict.fromkeys(seeds, trial)
        return trial.request()

    def follow(self, run: PlannedRun, values: Row) -> Iterable[PlannedRun]:
        """Request what the trial of a run needs next."""
        self._is_random |= uses_seed(values)
        trial = self.trials[run.point]
        trial.add(run, values)
        return trial.request()

    @property
    def all_trials(self) -> list[Trial]:
        """All trials, in the order in which they began."""
        return list({id(trial): trial for trial in self.trials.values()}.values())

    def ahead(self) -> Iterable[PlannedRun]:
        return runs_ahead(self.all_trials)

    def runs_at(
        self, index: int, at: int, value: float, variants: Iterable[Variant]
    ) -> Iterator[PlannedRun]:
        """Return the first run of a case at its `at`-th value in each variant."""
        wanted, case = self.definition, self.cases[index]
        tags = {**case.setting.tags, "quantity": wanted.quantity, "value": value}
        for variant in variants:
            yield PlannedRun(
                point_name(index, at, variant), case.setting.scenario,
                case.setting.of(value, variant), wanted.seeds[0],
                {**tags, **variant.columns}, bool(wanted.confirm),
            )  # fmt: skip


def point_name(case: int, value: int, variant: Variant) -> str:
    """Return a point's name: case, value and variant, so that names sort in order of requests."""
    return f"{case:03d}-{value:06d}-{variant.number:04d}"

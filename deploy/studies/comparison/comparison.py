"""A comparison: the same scenario, plant and seed under several laws, in virtual time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pydantic import Field

from deploy.judge.conditions import Conditions, conditions_of_runs
from deploy.judge.run_rows import Row
from deploy.run import run_folder
from deploy.run.simulate import require_simulable
from deploy.scenario import study_keys
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import naming, override, validated
from deploy.study.comparison.compared_runs import KIND, VARIED, law_folder
from deploy.study.comparison.settling import (
    LONGEST_S,
    SETTLING,
    SettlingTest,
    offset_of,
    settling_test,
)
from deploy.study.definition import Different, StudyDefinition, scenario_name
from deploy.study.planned_run import PlannedRun
from deploy.study.study import StudyOfRuns


class ComparisonDefinition(StudyDefinition):
    """Definition of a comparison, as stored in its folder.

    Attributes:
        scenario: a scenario file, or the name of a shipped one.
        laws: the laws; all shipped ones and the scenario's own if null.
        settling_rad: also start each law with errors of these sizes, until it has settled.
    """

    scenario: str
    laws: Different[str] | None = None
    settling_rad: list[float] = Field(default=[])


class LawComparison(StudyOfRuns):
    """The runs of a comparison: each law is recorded to its own folder, except for settling.

    Attributes:
        setups: the scenario with each law, by the law's name in results.
    """

    kind = KIND
    definition: ComparisonDefinition
    columns = MappingProxyType(VARIED)

    def __init__(self, values: Mapping[str, Any], source: Path) -> None:
        given = validated({"name": "compare", **values}, ComparisonDefinition, source)
        with naming(source):
            study_keys.require_effect(
                given.fixed,
                {study_keys.LAW: "as --laws", study_keys.UNCERTAINTY: "to sweep or margin"},
            )
            scenario = scenario_name(given.scenario, source.parent)
        own = load_setup(scenario, given.fixed_overrides).scenario
        laws = given.laws or study_keys.laws_beside(own.controller.law)
        self._overrides = {law: self._under(given, law) for law in laws}
        setups = [load_setup(scenario, overrides) for overrides in self._overrides.values()]
        with naming(source):
            study_keys.require_link_effect(given.fixed, setups)
        for setup in setups:
            if setup.scenario.controller.process is None:
                require_simulable(setup)
        self.setups = {setup.scenario.controller.name: setup for setup in setups}
        self.bases = setups[:1]
        chosen = {"scenario": scenario, "laws": laws, "seeds": [own.seed], "name": own.name}
        self.definition = given.model_copy(update=chosen)

    @staticmethod
    def _under(given: ComparisonDefinition, law: str) -> tuple[str, ...]:
        fixed = {key: value for key, value in given.fixed.items() if key != study_keys.SEED}
        return tuple(override(key, value) for key, value in {**fixed, study_keys.LAW: law}.items())

    @property
    def variants(self) -> list[Setup]:
        return list(self.setups.values())

    def first(self) -> Iterable[PlannedRun]:
        wanted = self.definition
        for index, ((law, setup), overrides) in enumerate(
            zip(self.setups.items(), self._overrides.values(), strict=True)
        ):
            yield PlannedRun(
                f"{index:03d}", wanted.scenario, overrides, wanted.seeds[0],
                {"law": law, "offset_rad": None}, bool(wanted.confirm), law_folder(law),
            )  # fmt: skip
            if setup.scenario.controller.process is None:  # it has no bound
                yield from self._starts(index, law, overrides)

    def _starts(self, index: int, law: str, overrides: Sequence[str]) -> Iterator[PlannedRun]:
        """Return the starts of a law with small and large errors."""
        duration_s = min(LONGEST_S, self.setups[law].scenario.duration_s)
        for place, (size_rad, offset_rad) in enumerate(self._offsets(law).items()):
            start = override("robot.initial_offset_rad", offset_rad)
            kept = [text for text in overrides if not text.startswith("duration_s=")]
            yield PlannedRun(
                f"{index:03d}-{place:02d}", self.definition.scenario,
                (*kept, start, override("duration_s", duration_s)), self.definition.seeds[0],
                {"law": law, "offset_rad": size_rad},
            )  # fmt: skip

    def findings(self, rows: list[Row]) -> dict[str, Any]:
        done = [row["law"] for row in rows if row["offset_rad"] is None]
        return {
            "scenario": self.bases[0].scenario.name,
            "seed": self.definition.seeds[0],
            "completed": len(rows) == self.expected,
            "runs_expected": self.expected,
            "laws": {law: {} for law in done},
            "settling": SETTLING.dump_python(self.settling(rows)),
        }

    def settling(self, rows: list[Row]) -> list[SettlingTest]:
        """Return the laws whose starts are all done."""
        found = list[SettlingTest]()
        for law in self.setups:
            started = {row["offset_rad"]: row for row in rows if row["law"] == law}
            offsets = self._offsets(law)
            if offsets and all(size in started for size in offsets):
                starts = [(offset_rad, started[size]) for size, offset_rad in offsets.items()]
                found.append(settling_test(law, starts))
        return found

    def _offsets(self, law: str) -> dict[float, list[float]]:
        """Return the initial errors of a law's starts, each once, by the smallest size."""
        sizes = {}
        for size_rad in sorted(self.definition.settling_rad, reverse=True):
            sizes[tuple(offset_of(self.setups[law], size_rad))] = size_rad  # its range may end
        return {size_rad: list(offset_rad) for offset_rad, size_rad in reversed(sizes.items())}

    def provenance(self) -> dict[str, Any]:
        return {**run_folder.manifest_of(self.variants), "laws": list(self.setups)}

    def conditions(self, summary: Mapping[str, Any], manifest: Mapping[str, Any]) -> Conditions:
        laws = [setup for law, setup in self.setups.items() if law in summary["laws"]]
        return conditions_of_runs(laws or self.bases, manifest)

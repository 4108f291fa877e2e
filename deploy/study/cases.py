"""What has a margin: a law on an arm, with or without compensation and feedback at the drives."""

from __future__ import annotations

import itertools
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

from pydantic import Field

from bus_schema.configuration import ConfigurationError, Positive
from deploy.judge.run_rows import Row
from deploy.scenario.definition import Name
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.study_keys import (
    LAW,
    SEED,
    laws_beside,
    require_effect,
    require_link_effect,
)
from deploy.scenario.yaml_files import ScenarioError, naming, override, validated
from deploy.study.plants import with_ranges
from deploy.study.quantities import Direction, Quantity, build_quantity, ceiling_of_value
from deploy.study.study import Different, PlannedRun, StudyDefinition, StudyOfRuns, scenario_name

CASE_COLUMNS = {
    "law": "string", "arm": "string", "compensation": "bool", "drive_feedback": "bool",
    "running": "bool", "quantity": "string", "value": "double",
}  # fmt: skip
"""Names and Parquet types of what tells a run of margins from others, but for its start."""


class CasesDefinition(StudyDefinition):
    """What has margins, as a study's YAML file has it.

    Attributes:
        scenarios: scenario files, or names of shipped ones.
        laws: control laws; all shipped ones and each scenario's own if null.
        compensation: values of ``controller.delay_compensation.enabled`` to try; as each scenario
            has it if none is given.
        drive_feedback: values of ``controller.drive_feedback.enabled`` to try, likewise.
        running: false where the quantity is there from the start, true where a loop that already
            runs meets it gradually, from 1 s to 3 s; null for the first alone, and for both where
            an arm has motors and the quantity can come gradually.
        quantity: what grows: ``delay`` (round trip, half each way), ``jitter`` or ``loss`` (each
            way), or the dotted key of any number of the scenario.
        direction: of the link, where it is to be one alone; the other is as the scenario has it.
        duration_s: length of each run; the scenario's own if null.
    """

    name: Name = "margin"
    scenarios: Different[str] = Field(default=["paper_arm"])
    laws: Different[str] | None = None
    compensation: Different[bool] | None = None
    drive_feedback: Different[bool] | None = None
    running: Different[bool] | None = None
    quantity: str = "delay"
    direction: Direction = "both"
    duration_s: Positive | None = None


@dataclass(frozen=True)
class Setting:
    """Something that has a margin.

    Attributes:
        scenario: file or name.
        base: the scenario as it is without the quantity.
        overrides: what is set in it but for the quantity.
        quantity: what grows.
    """

    scenario: str
    base: Setup
    law: str
    compensation: bool | None
    drive_feedback: bool | None
    running: bool
    overrides: tuple[str, ...]
    quantity: Quantity

    @property
    def tags(self) -> dict[str, Any]:
        """What tells it from the others."""
        return {
            "law": self.law,
            "arm": self.base.scenario.name,
            "compensation": self.compensation,
            "drive_feedback": self.drive_feedback,
            "running": self.running,
        }

    def at(self, value: float, more: Sequence[str] = ()) -> tuple[str, ...]:
        """What to set for a value of the quantity, and what else is set."""
        own = self.quantity.overrides(value, running=self.running)
        return (*self.overrides, *more, *own)


COMPENSATION = "controller.delay_compensation.enabled"
DRIVE_FEEDBACK = "controller.drive_feedback.enabled"


def settings(wanted: CasesDefinition, own: Mapping[str, str]) -> Iterator[Setting]:
    """All settings of a definition.

    Args:
        wanted: the definition.
        own: keys that its kind of study sets by itself, each with what to use in its place.

    Raises:
        ScenarioError: the scenario refuses one.
        ConfigurationError: so does what stands in the definition.
    """
    fixed = _fixed(wanted, own)
    unasked: Sequence[bool | None] = [None]
    chosen = itertools.product(
        [(scenario, law) for scenario in wanted.scenarios for law in _laws(wanted, scenario)],
        wanted.compensation or unasked, wanted.drive_feedback or unasked,
    )  # fmt: skip
    for (scenario, law), compensation, drive_feedback in chosen:
        asked = {LAW: law, COMPENSATION: compensation, DRIVE_FEEDBACK: drive_feedback}
        given = (override(key, value) for key, value in asked.items() if value is not None)
        overrides = (*fixed, *given)
        base = load_setup(scenario, overrides)
        for running, quantity in _loops(wanted, base):
            if not quantity.starts_from_own:
                require_effect(
                    wanted.fixed, dict.fromkeys(quantity.keys, "as quantity and limit or values")
                )
            name = base.scenario.controller.name
            yield Setting(
                scenario, base, name, compensation, drive_feedback, running, overrides, quantity
            )


def _loops(wanted: CasesDefinition, base: Setup) -> Iterator[tuple[bool, Quantity]]:
    """The quantity as it comes to a loop that starts, to one that runs, or both."""
    has_motors = base.scenario.plant.actuator.has_rotors
    for running in wanted.running or ([False, True] if has_motors else [False]):
        try:
            yield running, build_quantity(wanted.quantity, wanted.direction, running, base)
        except ConfigurationError:
            if not running or wanted.running is not None:  # else nobody asked for it
                raise


def _fixed(wanted: CasesDefinition, own: Mapping[str, str]) -> tuple[str, ...]:
    """What is set in all scenarios; errors as `settings`."""
    own = {**own, LAW: "as laws (--laws)", SEED: "as seeds (--seeds)"}
    if wanted.compensation is not None:
        own[COMPENSATION] = "as compensation (--compensation)"
    if wanted.drive_feedback is not None:
        own[DRIVE_FEEDBACK] = "as drive_feedback (--drive-feedback)"
    require_effect(wanted.fixed, own)
    if wanted.duration_s is None:
        return wanted.fixed_overrides
    if "duration_s" in wanted.fixed:
        allowed = "must be given once, under duration_s (--duration) or under set (--set)"
        raise ConfigurationError("duration_s", wanted.duration_s, allowed)
    return (*wanted.fixed_overrides, override("duration_s", wanted.duration_s))


def _laws(wanted: CasesDefinition, scenario: str) -> list[str]:
    if wanted.laws is not None:
        return wanted.laws
    return laws_beside(load_setup(scenario, wanted.fixed_overrides).scenario.controller.law)


@dataclass
class Case:
    """A setting, and what is tried with it.

    Attributes:
        setting: what it is.
        ceilings_ms: how long the arm may be held at each start, or of each plant, where known.
    """

    setting: Setting
    ceilings_ms: list[float]


C = TypeVar("C", bound=Case)


class StudyOfCases(StudyOfRuns, Generic[C]):
    """A study of a quantity that grows, in all settings of its definition.

    Attributes:
        definition_type: what its YAML file may have.
        cases: what is tried.
    """

    definition_type: ClassVar[type[CasesDefinition]]
    definition: Any
    cases: list[C]

    def __init__(self, values: Mapping[str, Any], source: Path) -> None:
        with naming(source):
            ranged = with_ranges(values, source)
        given = validated(ranged, self.definition_type, source)
        with naming(source):
            scenarios = [scenario_name(name, source.parent) for name in given.scenarios]
            self.definition = given.model_copy(update={"scenarios": scenarios})
            self.cases = list(self.build_cases())
            self._require_own_names()
            self.bases = list({base.scenario.name: base for base in self.variants}.values())
            require_link_effect({**given.fixed, given.quantity: None}, self.bases)

    @abstractmethod
    def build_cases(self) -> Iterator[C]:
        """All cases, each checked at the last value; errors as `settings`."""

    @abstractmethod
    def case_findings(self, rows: list[Row]) -> dict[str, Any]:
        """What came of the cases, and whether all is `completed`, ready for JSON."""

    def _require_own_names(self) -> None:
        """Rows tell scenarios by their names."""
        files: dict[str, str] = {}
        for setting in (case.setting for case in self.cases):
            name = setting.base.scenario.name
            if files.setdefault(name, setting.scenario) != setting.scenario:
                raise ScenarioError(
                    f"scenarios: {files[name]} and {setting.scenario} are both called {name!r}:"
                    " must have names of their own"
                )

    @property
    def variants(self) -> list[Setup]:
        return [case.setting.base for case in self.cases]

    def findings(self, rows: list[Row]) -> dict[str, Any]:
        quantity = self.cases[0].setting.quantity
        return {
            "quantity": self.definition.quantity,
            "title": quantity.title,
            "unit": quantity.unit,
            "duration_s": {base.scenario.name: base.scenario.duration_s for base in self.bases},
            **self.case_findings(rows),
        }

    def ceilings_ms(self, setting: Setting, setups: Iterable[Setup]) -> list[float]:
        """The held-arm ceilings of a delay that is there from the start, where there are any."""
        if setting.running or self.definition.quantity != "delay":
            return []
        found = (ceiling_of_value(setup, self.definition.direction) for setup in setups)
        return [each for each in found if each is not None]

    def planned(
        self, point: str, setting: Setting, value: float, seeds: Sequence[int],
        more: Sequence[str], columns: Mapping[str, Any],
    ) -> list[PlannedRun]:  # fmt: skip
        """The runs of a setting at a value, one for each seed.

        Args:
            point: their name.
            setting: what is tried.
            value: of the quantity.
            seeds: those of the scenario.
            more: what else is set.
            columns: what else tells them from others.
        """
        tags = {**setting.tags, "quantity": self.definition.quantity, "value": value, **columns}
        overrides, confirms = setting.at(value, more), bool(self.definition.confirm)
        return [
            PlannedRun(point, setting.scenario, overrides, seed, tags, confirms) for seed in seeds
        ]

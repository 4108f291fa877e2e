"""What has a margin: a law on an arm, with or without compensation and feedback at the drives."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import Field

from bus_schema.configuration import ConfigurationError, Positive
from deploy.scenario.definition import Name
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.study_keys import LAW, SEED, laws_beside, require_effect
from deploy.scenario.yaml_files import override
from deploy.study.margins.quantities import Direction, Quantity, build_quantity
from deploy.study.study import Different, StudyDefinition, scenario_name

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
            runs meets it gradually, from 1 s to 3 s.
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
    running: Different[bool] = Field(default=[False])
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


def scenarios_of(wanted: CasesDefinition, source: Path) -> list[str]:
    """The scenarios as studies name them; see `scenario_name`."""
    return [scenario_name(name, source.parent) for name in wanted.scenarios]


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
        wanted.compensation or unasked, wanted.drive_feedback or unasked, wanted.running,
    )  # fmt: skip
    for (scenario, law), compensation, drive_feedback, running in chosen:
        asked = {LAW: law, COMPENSATION: compensation, DRIVE_FEEDBACK: drive_feedback}
        given = (override(key, value) for key, value in asked.items() if value is not None)
        overrides = (*fixed, *given)
        base = load_setup(scenario, overrides)
        quantity = build_quantity(wanted.quantity, wanted.direction, running, base)
        if not quantity.starts_from_own:
            require_effect(
                wanted.fixed, dict.fromkeys(quantity.keys, "as quantity and limit or values")
            )
        name = base.scenario.controller.name
        yield Setting(
            scenario, base, name, compensation, drive_feedback, running, overrides, quantity
        )


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


def bases_of(all_settings: Sequence[Setting]) -> list[Setup]:
    """One scenario of each name."""
    return list({one.base.scenario.name: one.base for one in all_settings}.values())

"""Settings that have a margin: a law on an arm, with or without compensation and drive loop."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import Field

from bus_schema.configuration import ConfigurationError, Positive
from deploy.scenario import study_keys
from deploy.scenario.definition import Name
from deploy.scenario.held_arm import Direction
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import override
from deploy.study.definition import Different, StudyDefinition
from deploy.study.plants import Variant
from deploy.study.quantities import Quantity, build_quantity, excitation


class CasesDefinition(StudyDefinition):
    """Cases that have margins, as in a study's YAML file.

    Attributes:
        scenarios: scenario files, or names of shipped ones.
        laws: control laws; all shipped ones and each scenario's own if null.
        compensation: values of ``controller.delay_compensation.enabled`` to try; each scenario's
            own value by default.
        drive_feedback: values of ``controller.drive_feedback.enabled`` to try, likewise.
        running: false if the quantity acts from the start, true if it grows gradually, from 1 s to
            3 s, in a running loop; null for the first alone, and for both if an arm has motors and
            the quantity can grow gradually.
        quantity: the quantity that grows: ``delay`` (round trip, half each way), ``jitter`` or
            ``loss`` (each way), or the dotted key of any number of the scenario.
        direction: only this direction of the link is varied; the other stays as in the scenario.
        duration_s: length of each run; the scenario's own if null.
        excitation: a pulse of torque pushes every joint of a running loop when the quantity has its
            full size, because a loop at rest may be unstable without a trace: 1 % of the joint's
            largest torque for 20 ms, where that torque is known.
        exhaustive: every run lasts to its end, and every start, seed and plant is tried, also where
            fewer decide; always so with ``confirm``.
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
    excitation: bool = True
    exhaustive: bool = False

    @property
    def is_exhaustive(self) -> bool:
        return self.exhaustive or bool(self.confirm)


@dataclass(frozen=True)
class Setting:
    """A setting that has a margin.

    Attributes:
        scenario: file or name.
        base: the scenario without the quantity.
        tags: values that distinguish it from the others.
        overrides: values set in it, except the quantity.
        quantity: what grows.
    """

    scenario: str
    base: Setup
    tags: dict[str, Any]
    overrides: tuple[str, ...]
    quantity: Quantity

    def at(self, value: float, more: Sequence[str] = ()) -> tuple[str, ...]:
        """Return the overrides for a value of the quantity, with all others."""
        own = self.quantity.overrides(value, running=self.tags["running"])
        return (*self.overrides, *more, *own)

    def of(self, value: float, variant: Variant) -> tuple[str, ...]:
        """Return the overrides for a value of the quantity in a variant."""
        return (*self.at(value, variant.overrides), *variant.last)


COMPENSATION = "controller.delay_compensation.enabled"
DRIVE_FEEDBACK = "controller.drive_feedback.enabled"


def settings(wanted: CasesDefinition, own: Mapping[str, str]) -> Iterator[Setting]:
    """Return all settings of a definition.

    Args:
        wanted: the definition.
        own: keys that its kind of study sets by itself, each with the alternative to use.

    Raises:
        ScenarioError: a scenario refuses a setting.
        ConfigurationError: a value of the definition is invalid.
    """
    fixed = _fixed(wanted, own)
    unasked: Sequence[bool | None] = [None]
    chosen = itertools.product(
        [(scenario, law) for scenario in wanted.scenarios for law in _laws(wanted, scenario)],
        wanted.compensation or unasked, wanted.drive_feedback or unasked,
    )  # fmt: skip
    for (scenario, law), compensation, drive_feedback in chosen:
        asked = {study_keys.LAW: law, COMPENSATION: compensation, DRIVE_FEEDBACK: drive_feedback}
        given = (override(key, value) for key, value in asked.items() if value is not None)
        overrides = (*fixed, *given)
        base = load_setup(scenario, overrides)
        for running, quantity in _loops(wanted, base):
            if quantity.is_of_link:
                study_keys.require_effect(
                    wanted.fixed, dict.fromkeys(quantity.keys, "as quantity and limit or values")
                )
            tags = {
                "law": base.scenario.controller.name,
                "arm": base.scenario.name,
                "compensation": compensation,
                "drive_feedback": drive_feedback,
                "running": running,
            }
            pulses = excitation(base) if running and wanted.excitation else ()
            yield Setting(scenario, base, tags, (*overrides, *pulses), quantity)


def _loops(wanted: CasesDefinition, base: Setup) -> Iterator[tuple[bool, Quantity]]:
    """Return the quantity acting on a loop from the start, on a running one, or both."""
    has_motors = base.scenario.plant.actuator.has_rotors
    for running in wanted.running or ([False, True] if has_motors else [False]):
        try:
            yield running, build_quantity(wanted.quantity, wanted.direction, running, base)
        except ConfigurationError:
            if not running or wanted.running is not None:  # not requested
                raise


def _fixed(wanted: CasesDefinition, own: Mapping[str, str]) -> tuple[str, ...]:
    """Return the values set in all scenarios; raises as `settings`."""
    own = {**own, study_keys.LAW: "as laws (--laws)", study_keys.SEED: "as seeds (--seeds)"}
    if wanted.compensation is not None:
        own[COMPENSATION] = "as compensation (--compensation)"
    if wanted.drive_feedback is not None:
        own[DRIVE_FEEDBACK] = "as drive_feedback (--drive-feedback)"
    study_keys.require_effect(wanted.fixed, own)
    if wanted.duration_s is None:
        return wanted.fixed_overrides
    if "duration_s" in wanted.fixed:
        allowed = "must be given once, under duration_s (--duration) or under set (--set)"
        raise ConfigurationError("duration_s", wanted.duration_s, allowed)
    return (*wanted.fixed_overrides, override("duration_s", wanted.duration_s))


def _laws(wanted: CasesDefinition, scenario: str) -> list[str]:
    if wanted.laws is not None:
        return wanted.laws
    return study_keys.laws_beside(
        load_setup(scenario, wanted.fixed_overrides).scenario.controller.law
    )

"""Remedies at the value at which a case fails."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bus_schema.link.configuration import AUTO
from controller.laws import LAWS
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import override, plain
from deploy.study.cases import Case
from deploy.study.follow_ups.trials import (
    COLUMN,
    Changes,
    Trials,
    command_of,
    trials,
    variant_of,
    worst_of,
)
from deploy.study.margin_search import MarginSearch
from deploy.study.plants import Variant
from deploy.study.settings import COMPENSATION, DRIVE_FEEDBACK, Setting

_SHAPES = ("slope", "alpha", "beta", "inertia_kg_m2", "rate")
"""Gains per joint that shape a surface, an observer or a funnel; all others scale the torque."""


def changes(setup: Setup) -> Changes:
    """Return what may help an arm, by name; some of it may be in force already."""
    law = setup.scenario.controller.law
    found = {
        "compensation": (override(COMPENSATION, True),),
        "drive loop": (override(DRIVE_FEEDBACK, True),),
        "twice the rate": (override("rate_hz", 2.0 * setup.scenario.rate_hz),),
    }
    if not setup.link.plays_automatically:
        found["automatic play-out"] = (override("link.playout_ms", AUTO),)
    if law in LAWS:
        gains = setup.gains._asdict()
        half = {
            key: 0.5 * gain
            for key, gain in gains.items()
            if isinstance(gain, np.ndarray) and key not in _SHAPES
        }
        found["half the gains"] = (override(f"controller.gains.{law}", plain({**gains, **half})),)
    return found


@dataclass(kw_only=True)
class RemedyTrials(Trials):
    """Remedies at one value: first from the start that was lost there, then from the others.

    Attributes:
        others: the same remedies from the other starts; those that held are tried from these.
    """

    others: list[Variant] = field(default_factory=list)

    @property
    def variants_at_most(self) -> int:
        return super().variants_at_most + len(self.others)

    def next(self) -> int | None:
        steps = super().next()
        if steps is None and self.others:
            held = {each[COLUMN] for each in self.findings() if each["held"]}
            more = [each for each in self.others if each.columns[COLUMN] in held]
            self.others = []
            if more:
                self.variants += more
                (steps,) = self.values
                del self.outcomes[steps]
        return steps


def trials_of(case: Case, search: MarginSearch, at: int, most: int) -> RemedyTrials:
    """Return the trials of what may help at the first failure of a case.

    Args:
        case: the case.
        search: the search for its margin, which has a first failure.
        at: number of the first variant.
        most: largest number of variants.
    """
    (steps,) = values = [search.first_failure or 0]
    found = trials(case, search.steps, values, changes(case.setting.base), at)
    lost = variant_of(search, worst_of(search.rows[steps])).overrides
    from_lost = [each for each in found.variants if each.overrides[: len(lost)] == lost]
    others = [each for each in found.variants if each not in from_lost]
    return RemedyTrials(
        search.steps, variants=from_lost[:most], values=found.values if from_lost[:most] else [],
        others=others[: max(0, most - len(from_lost))],
    )  # fmt: skip


def findings(setting: Setting, trials: Trials) -> dict[str, Any] | None:
    """Return what was tried, and the best of what helped; None if nothing was.

    What helped has the command that repeats it.
    """
    if not (tried := trials.findings()):
        return None
    for each in filter(lambda one: one["held"], tried):
        overrides = setting.of(each["value"], variant_of(trials, each))
        each["command"] = command_of(setting, overrides, each)
    # The offset at the start often decides the smallest margin: of equal ones, errors count.
    best = min(
        (each for each in tried if each["held"]),
        default=None,
        key=lambda each: (-round(each["margin_min"], 2), each["worst_rms_rad"] or 0.0),
    )
    return {"value": tried[0]["value"], "tried": tried, "best": best}

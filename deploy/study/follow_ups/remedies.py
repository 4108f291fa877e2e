"""What helps at the value at which a case fails."""

from __future__ import annotations

from typing import Any

import numpy as np

from bus_schema.link.configuration import AUTO
from controller.laws import LAWS
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import override, plain
from deploy.study.cases import COMPENSATION, DRIVE_FEEDBACK, Setting
from deploy.study.follow_ups.trials import Changes, Trials, command_of, variant_of

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

"""Reasons why the runs of a study do not show a margin."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from deploy.judge.run_rows import Row
from deploy.study.quantities import RAMP_FOR_S, RAMP_FROM_S
from deploy.study.settings import Setting
from deploy.study.statistics import NO_EFFECT, without_effect

TIME_CONSTANTS = 10
"""Of the funnel: this long the quantity must act at its full size."""
_NEAR_S = 1e-9


def doubts(setting: Setting, rows: Sequence[Row], columns: Iterable[str]) -> list[str]:
    """Return why the runs of a setting do not show its margin, a sentence each; [] if they do.

    Args:
        setting: the setting.
        rows: its rows.
        columns: the columns that identify a run in its study.
    """
    found = list(filter(None, [too_short(setting)]))
    if without_effect(rows, [("value",)], columns):
        found.append(f"{setting.quantity.title}: {NO_EFFECT}")
    return found


def too_short(setting: Setting) -> str:
    """Return why runs of a setting are too short to show its margin; empty if they are not."""
    scenario = setting.base.scenario
    full_s = RAMP_FROM_S + RAMP_FOR_S if setting.tags["running"] else 0.0
    least_s = full_s + TIME_CONSTANTS / scenario.funnel.rate_per_s
    if scenario.duration_s >= least_s - _NEAR_S:
        return ""
    return (
        f"runs of {scenario.duration_s:g} s are too short: they must last {least_s:g} s"
        f" (--duration {math.ceil(least_s)}), {TIME_CONSTANTS} time constants of the funnel"
        " after the quantity has its full size"
    )

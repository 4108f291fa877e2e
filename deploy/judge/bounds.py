"""The true error of a run against the scenario's funnel, at every tick."""

from __future__ import annotations

import math
from typing import Annotated, Any

import numpy as np

from bus_schema.arrays import Matrix
from bus_schema.messages import topics
from bus_schema.messages.run_event import EventKind
from bus_schema.messages.topics import Role
from deploy.judge.recorded_ticks import KnownTicks, known_ticks, tick_numbers
from deploy.judge.result.section import Column, Section
from deploy.judge.run_data import RunData

_COUNTED = ("ticks", "outside", "margin_min")


class Bounds(Section):
    """The true error in its funnel.

    Attributes:
        violation_fraction: share of ticks with the true error of any joint outside its funnel
        first_violation_s: time of the first such tick; null for none
        margin_min: smallest 1 − |e| / bound over all joints and ticks; below 0: outside
        margin_min_joint: joint of that margin
        margin_min_s: time of that margin
        margin_start: the smallest margin of all joints at the first tick, which the initial offset
            alone decides; null if that tick is not recorded
        margin_steady: the smallest margin from ``metrics.from_s`` on, once the bounds have
            narrowed; null for shorter runs
        kept: whether the verdict is ``kept``
    """

    violation_fraction: Annotated[float | None, Column()] = None
    first_violation_s: Annotated[float | None, Column(of_any_part=True)] = None
    margin_min: Annotated[float | None, Column()] = None
    margin_min_joint: str | None = None
    margin_min_s: float | None = None
    margin_start: float | None = None
    margin_steady: float | None = None
    kept: Annotated[bool, Column("bounds_kept", of_any_part=True)] = False


def bound_usage(run: RunData) -> Matrix:
    """Return |e| over the bound on the error's side, at every tick, shape (ticks, joints)."""
    errors = run.true_errors_rad
    upper, lower = run.setup.funnel.bounds(run.times_s(topics.PLANT_TRUTH))
    return np.where(errors >= 0.0, errors / upper, errors / lower)


def judge_bounds(run: RunData) -> Bounds:
    """Judge how the true error kept inside the funnel, at the known ticks.

    An error that is NaN counts as outside, since the arm's position is unknown. Without any tick
    there is nothing to judge. `deploy.judge.verdict` decides what follows.
    """
    usage = bound_usage(run)
    if len(usage) < 2:  # the first is where the arm stood before any tick
        return Bounds()
    outside, times_s = ~(usage < 1.0).all(axis=1), run.times_s(topics.PLANT_TRUTH)
    tick, joint = np.unravel_index(usage.argmax(), usage.shape)
    return Bounds(
        violation_fraction=float(outside.mean()),
        first_violation_s=float(times_s[np.argmax(outside)]) if outside.any() else None,
        margin_min=_margin(usage),
        margin_min_joint=run.setup.robot.joint_names[joint],
        margin_min_s=float(times_s[tick]),
        margin_start=_margin(usage[tick_numbers(run) == 0]),
        margin_steady=_margin(usage[times_s >= run.setup.scenario.metrics.from_s]),
    )


def may_have_moved(run: RunData, known: KnownTicks) -> bool:
    """Whether a command was in force before the last tick, or may have been at a missing one."""
    ages_ns = run.tables[topics.PLANT_TRUTH.name]["command_age_ns"]
    return bool((ages_ns[:-1] >= 0).any() or known.missing)


def _margin(usage: Matrix) -> float | None:
    """The smallest margin; None where there is no tick, or an error that is not a number."""
    largest = float(usage.max()) if len(usage) else math.nan
    return 1.0 - largest if math.isfinite(largest) else None


def all_damage(run: RunData, bounds: Bounds | None = None) -> list[str]:
    """Return what is damaged in a recording, by its file and by the plant's own report.

    Args:
        run: the run.
        bounds: result of `judge_bounds`, where it is known.
    """
    bounds = judge_bounds(run) if bounds is None else bounds
    return [*run.damage, *_disagreement(run, bounds, known_ticks(run)), *_lacks_end(run)]


def _disagreement(run: RunData, bounds: Bounds, known: KnownTicks) -> list[str]:
    """Report how the plant's own count differs from its recording, if no tick is missing.

    Args:
        run: the run.
        bounds: result of `judge_bounds`.
        known: which of its ticks are recorded.
    """
    counted = plant_count(run)
    is_all = not known.missing and 0 in tick_numbers(run)
    if len(counted) < len(_COUNTED) or not is_all or bounds.violation_fraction is None:
        return []
    rows = len(run.tables[topics.PLANT_TRUTH.name])
    found = (rows, round(bounds.violation_fraction * rows), bounds.margin_min)
    counted_by_plant = tuple(counted[name] for name in _COUNTED)
    margins = (math.inf if each[-1] is None else each[-1] for each in (found, counted_by_plant))
    # Another machine's functions may differ in their last bits.
    is_same = found[:-1] == counted_by_plant[:-1] and math.isclose(
        *margins, rel_tol=1e-6, abs_tol=1e-6
    )
    ours, theirs = (
        f"{outside} of {ticks} ticks outside, smallest margin {margin}"
        for ticks, outside, margin in (found, counted_by_plant)
    )
    return [] if is_same else [f"it has {ours}, but the plant counted {theirs}"]


def _lacks_end(run: RunData) -> list[str]:
    """Report that a recording shows a working plant, but not how it ended.

    The failure of a process already explains that.
    """
    is_ended = "ticks" in run.last_values(Role.PLANT, EventKind.ENDED)
    if is_ended or run.faults() or not len(run.tables[topics.PLANT_TRUTH.name]):
        return []
    return ["the end of the plant is missing, so the run may have continued"]


def plant_count(run: RunData) -> dict[str, Any]:
    """Return the plant's own count of the funnel; {} for older versions and other plants."""
    return dict(run.last_values(Role.PLANT, EventKind.ENDED).get("bounds", {}))

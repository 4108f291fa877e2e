"""Why a run left its funnel, from the time just before and after."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.messages import topics
from deploy.judge.bounds import bound_usage
from deploy.judge.run_data import RunData

_BEFORE_S = 1.0
"""Time before the loss that is looked at."""
_MOSTLY = 0.5
_LATELY_S, _MUCH_OLDER, _LATE_NS = 0.15, 3.0, 10e6
"""A command that was in force within this time before the loss, and older than usual by both, is
its likely cause."""
AFTER_S = 0.3
"""Time after the loss in which its oscillation continues, if there is one."""
_FEWEST_SWINGS, _MOST_SWINGS = 4, 8
_LEAST_SWING = 0.1
"""Share of the largest swing below which one is the reference's own, or noise."""


class LossReason(NamedTuple):
    """Why a run left its funnel.

    Attributes:
        reason: ``start``: no command had acted yet, brakes held the arm; ``growing``: an
            oscillation grew; ``late command``: shortly before, a command in force was much older
            than usual; ``saturated``: torques were at their limits for most of the time
            before; ``friction or model``: anything else, a slow error.
        joint: the first one outside.
        time_s: when.
        rate_per_s: of an oscillation, its growth e^(rate t); None for none.
        frequency_hz: likewise.
    """

    reason: str
    joint: str
    time_s: float
    rate_per_s: float | None = None
    frequency_hz: float | None = None


def loss_reason(run: RunData) -> LossReason | None:
    """Return why a run left its funnel; None if it did not, or was never moved."""
    usage = bound_usage(run)
    outside = np.flatnonzero(~(usage < 1.0).all(axis=1))
    if not outside.size:
        return None
    tick, truth = int(outside[0]), run.tables[topics.PLANT_TRUTH.name]
    worst = np.nan_to_num(usage[tick], nan=np.inf)  # an unknown position counts as outside
    joint, times_s = int(worst.argmax()), run.times_s(topics.PLANT_TRUTH)
    place = run.setup.robot.joint_names[joint], float(times_s[tick])
    acting = np.flatnonzero(truth["command_age_ns"][: tick + 1] >= 0)
    if not acting.size:
        return LossReason("start", *place)
    first = max(int(acting[0]), int(np.searchsorted(times_s, times_s[tick] - _BEFORE_S)))
    before = slice(first, tick + 1)
    around = slice(first, int(np.searchsorted(times_s, times_s[tick] + AFTER_S)))
    growth = _growing_swings(times_s[around], run.true_errors_rad[around, joint])
    if growth is not None:
        return LossReason("growing", *place, *growth)
    if _was_late(times_s[before], truth["command_age_ns"][before]):
        return LossReason("late command", *place)
    is_saturated = truth["saturated"][before].mean() > _MOSTLY
    return LossReason("saturated" if is_saturated else "friction or model", *place)


def _was_late(times_s: Vector, ages_ns: Vector) -> bool:
    """Whether a command in force in the last moments was much older than usual before."""
    usual_ns, recent = np.median(ages_ns), times_s >= times_s[-1] - _LATELY_S
    return bool(ages_ns[recent].max() > max(_MUCH_OLDER * usual_ns, usual_ns + _LATE_NS))


def _growing_swings(times_s: Vector, errors_rad: Vector) -> tuple[float, float] | None:
    """Return growth (1/s) and frequency (Hz) of an oscillation; None for none that grows."""
    if not np.isfinite(errors_rad).all():
        return None
    steps = np.diff(errors_rad)
    turns = np.flatnonzero(steps[1:] * steps[:-1] < 0.0) + 1
    swings = np.abs(np.diff(errors_rad[turns]))
    if not swings.size:
        return None
    grown = int(swings.argmax())  # it may saturate later
    is_large = np.flatnonzero(swings >= _LEAST_SWING * swings[grown])
    used = is_large[is_large <= grown][-_MOST_SWINGS:]
    if len(is_large) < _FEWEST_SWINGS or len(used) < 2:
        return None
    rate, _ = np.polyfit(times_s[turns[used + 1]], np.log(swings[used]), 1)
    half_periods_s = np.diff(times_s[turns])[is_large]
    return float(rate), float(0.5 / np.median(half_periods_s))

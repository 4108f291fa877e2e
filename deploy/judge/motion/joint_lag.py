"""The lag of joints: the time by which they are behind their reference."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bus_schema.messages import topics
from bus_schema.runtime.modes import Mode
from deploy.judge.run_data import ROBOT_SERVER, RunData

_MS = 1e3
_STILL_RAD_S = 1e-6
"""RMS of a reference's velocity; slower ones show no lag."""

_HALF_S = 0.05


def lag_ms(run: RunData) -> list[float | None]:
    """Return the lag of each joint's true error, ms, at `follows`.

    Negative for a joint that is ahead. None where the reference rests, and where the lag would be
    longer than the time that is judged: such a joint does not follow its reference.
    """
    times_s, truth = run.times_s(topics.PLANT_TRUTH), run.tables[topics.PLANT_TRUTH.name]
    rows, errors, speeds = follows(run), run.true_errors_rad, run.reference_velocities_rad_s
    if run.link == ROBOT_SERVER:  # what a client asks for arrives in steps and bursts
        speeds = mean_speeds_rad_s(times_s, truth["position"] - errors)
    lags = lags_s(errors[rows], speeds[rows])
    longest_s = 1e-9 * run.setup.grid.period_ns * rows.sum()
    return [_MS * float(each) if abs(each) <= longest_s else None for each in lags]


def follows(run: RunData) -> NDArray[np.bool_]:
    """Return at which ticks commands move the arm, from ``metrics.from_s`` on; shape (ticks,)."""
    truth, from_s = run.tables[topics.PLANT_TRUTH.name], run.setup.scenario.metrics.from_s
    stops = np.isin(truth["mode"], (Mode.STOPPING, Mode.FAULT))
    is_judged = run.times_s(topics.PLANT_TRUTH) >= from_s
    return np.asarray(is_judged & ~stops & (truth["command_age_ns"] >= 0))


def mean_speeds_rad_s(
    times_s: NDArray[np.float64], positions_rad: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the mean speeds over 100 ms around each tick, or as much of them as is known.

    Args:
        times_s: increasing, shape (ticks,).
        positions_rad: shape (ticks, joints).
    """
    if len(times_s) < 2:
        return np.zeros_like(positions_rad)
    last = len(times_s) - 1
    ends = np.minimum(np.searchsorted(times_s, times_s + _HALF_S), last)
    starts = np.searchsorted(times_s, times_s - _HALF_S)
    spans_s = times_s[ends] - times_s[starts]
    return np.asarray((positions_rad[ends] - positions_rad[starts]) / spans_s[:, None])


def lags_s(
    errors_rad: NDArray[np.float64], velocities_rad_s: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the time T of e = −T q̇_d, s, by least squares over all ticks; NaN where q̇_d rests.

    Args:
        errors_rad: shape (ticks,) or (ticks, joints).
        velocities_rad_s: of the reference, same shape.
    """
    square = (velocities_rad_s**2).sum(axis=0)
    moves = square > _STILL_RAD_S**2 * max(len(velocities_rad_s), 1)
    with np.errstate(invalid="ignore", over="ignore"):
        product = (errors_rad * velocities_rad_s).sum(axis=0)
        return np.asarray(-product / np.where(moves, square, np.nan))

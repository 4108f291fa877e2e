"""Cost of a trial of gains: error and smoothness, or the delay that is survived."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from deploy.judge.run_rows import Row, is_whole, left_nothing, tolerated
from deploy.scenario.setup import Setup

SMOOTHNESS_WEIGHT = 0.25
"""Weight of the torque's total variation against that of the error, both as logarithms."""
EXCESS_WEIGHT = 10.0
"""Weight of variation beyond its limit against that of the error, both as logarithms."""
UNFINISHED = 1000.0
"""Cost beyond any of a run that counts."""
_LOST_WEIGHT = 0.5
_LEAST = 1e-12
"""Stands for errors and travel of zero, as of a law without torque, which have no logarithm."""


def error_cost(row: Row, setup: Setup, travel_limit_per_s: float | None) -> float:
    """Return what a run costs: its error first, the variation of its torque second.

    Both count as logarithms, averaged over joints. To leave the funnel, and to reach a limit of the
    torque, cost as much as an error e times as large each, and more with time.

    Args:
        row: the run.
        setup: its scenario.
        travel_limit_per_s: how far a torque may travel, in its own limits per second; less travel
            is worth nothing. None: all travel counts.
    """
    if left_nothing(row) or not row["completed"] or not is_whole(row):
        return UNFINISHED
    errors = np.array(row["rms_rad"]) / setup.funnel.final_rad
    travel = np.array(row["total_variation_nm_per_s"]) / setup.robot.effort_limits_nm
    shares = (row["violation_fraction"], row["saturated_fraction"])
    failings = sum(1.0 + 10.0 * share for share in shares if share > 0.0)
    if travel_limit_per_s is None:
        roughness = SMOOTHNESS_WEIGHT * np.log(np.maximum(travel, _LEAST)).mean()
    else:
        excess = np.log(np.maximum(travel / travel_limit_per_s, 1.0))
        roughness = excess.any() + EXCESS_WEIGHT * excess.mean()
    cost = float(np.log(np.maximum(errors, _LEAST)).mean() + roughness + failings)
    return cost if math.isfinite(cost) else UNFINISHED


def delay_cost(rows: Sequence[Row], duration_s: float) -> float:
    """Return the cost of runs at several delays: less 1 for each that is kept.

    A lost run counts by how long it was kept, at most half, so that a search has a slope to follow.
    """
    return -sum(_kept_part(row, duration_s) for row in rows)


def _kept_part(row: Row, duration_s: float) -> float:
    if tolerated(row):
        return 1.0
    lost_s = row["first_violation_s"]
    return 0.0 if lost_s is None else _LOST_WEIGHT * min(lost_s / duration_s, 1.0)

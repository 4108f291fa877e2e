"""Whether a run kept its bounds: the true error against the scenario's funnel, at every tick."""

from __future__ import annotations

from typing import Any

import numpy as np

from bus_schema.arrays import Matrix
from bus_schema.messages import topics
from deploy.runs.run_data import RunData


def bound_usage(run: RunData) -> Matrix:
    """|e| over the bound on the error's own side, at every tick, shape (ticks, joints)."""
    errors = run.true_errors_rad
    upper, lower = run.setup.funnel.bounds(run.times_s(topics.PLANT_TRUTH))
    return np.where(errors >= 0.0, errors / upper, errors / lower)


def judge_bounds(run: RunData) -> dict[str, Any]:
    """Whether the true error stayed inside the funnel at every tick.

    Where the plant came to no tick there is nothing to judge, and nothing is kept.
    """
    usage = bound_usage(run)
    if len(usage) < 2:  # the first is where the arm stood before any tick
        return {"kept": False, "violation_fraction": None, "first_violation_s": None,
                "margin_min": None}  # fmt: skip
    outside = (usage >= 1.0).any(axis=1)
    first = float(run.times_s(topics.PLANT_TRUTH)[np.argmax(outside)]) if outside.any() else None
    return {
        "kept": not outside.any(),
        "violation_fraction": float(outside.mean()),
        "first_violation_s": first,
        "margin_min": float(1.0 - usage.max()),
    }

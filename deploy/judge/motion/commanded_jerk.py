"""Jerk of the motion that a controller commands with targets."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Matrix
from bus_schema.messages import topics
from bus_schema.messages.types import stamps_ns
from deploy.judge.run_data import RunData


class Jerk(NamedTuple):
    """Jerk of commanded positions, rad/s³, of the joint where it is largest.

    Attributes:
        largest: of all times.
        rms: over all times, of the joint where it is largest.
        joint: number of the joint with `largest`.
    """

    largest: float
    rms: float
    joint: int


def commanded_jerk(run: RunData) -> Jerk | None:
    """Return the jerk of the commanded positions; None if there are too few of them.

    It is a third difference over the time between two actions of the law, at each tick: a mean of
    the jerk over three actions. Between actions a target may go on in steps, which robots smooth.
    """
    controller, period_ns = run.setup.scenario.controller, run.setup.grid.period_ns
    tick_s = 1e-9 * period_ns
    action_s = tick_s if controller.chunks is None else controller.chunks.action_period_s(tick_s)
    apart = max(1, round(action_s / tick_s))
    positions = _positions(run, period_ns)
    if len(positions) <= 3 * apart:
        return None
    for _ in range(3):
        positions = (positions[apart:] - positions[:-apart]) / (apart * tick_s)
    sizes, rms = np.abs(positions).max(axis=0), np.sqrt((positions**2).mean(axis=0))
    joint = int(sizes.argmax())
    return Jerk(float(sizes[joint]), float(rms.max()), joint)


def _positions(run: RunData, period_ns: int) -> Matrix:
    """Return the position commanded at each tick, rad, shape (ticks, joints); it is held."""
    commands = run.tables[topics.JOINT_COMMANDS.name]
    if "position" not in (commands.dtype.names or ()):
        return np.empty((0, 0))
    ticks = stamps_ns(commands) // period_ns
    is_target = np.isfinite(commands["position"]).all(axis=1)
    used = np.flatnonzero(is_target & (ticks >= 0) & (ticks <= run.setup.ticks))
    if not used.size:
        return np.empty((0, 0))
    used = used[np.argsort(ticks[used], kind="stable")]
    at = np.arange(ticks[used[0]], ticks[used[-1]] + 1)
    newest = used[np.searchsorted(ticks[used], at, "right") - 1]
    positions: Matrix = commands["position"][newest]
    return positions

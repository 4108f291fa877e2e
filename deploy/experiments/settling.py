"""Fixed time put to the test: settling times from near and far, against the one bound."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bus_schema.arrays import Vector
from deploy.experiments.metrics import summarise
from deploy.experiments.simulate import simulate
from deploy.scenario import Setup, check

OFFSETS_RAD = (0.01, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 1.0)
_DURATION_S = 8.0


@dataclass(frozen=True)
class SettlingRow:
    """One start.

    Attributes:
        offset_rad: initial error of the joints, shape (joints,).
        settling_time_s: when the last joint entered the funnel's final bound to stay; None if not.
        bounds_kept: whether no joint ever left the funnel.
    """

    offset_rad: Vector
    settling_time_s: float | None
    bounds_kept: bool


@dataclass(frozen=True)
class SettlingTest:
    """All starts of one law.

    Attributes:
        law: its name.
        bound_s: the bound that holds for every start; None for a law that has none.
    """

    law: str
    bound_s: float | None
    rows: list[SettlingRow]

    @property
    def holds(self) -> bool:
        """Whether there is a bound and every start settled within it."""
        times = [row.settling_time_s for row in self.rows]
        bound = self.bound_s
        return bound is not None and all(time is not None and time <= bound for time in times)


def settling_test(setup: Setup, offsets_rad: Sequence[float] = OFFSETS_RAD) -> SettlingTest:
    """Run a scenario from several distances, long enough for the bound to be seen to hold.

    Every joint starts off by the same size, on the side of the scenario's own offset, or on the
    other where its range ends before. The funnel opens with the offset, as the scenario says.
    """
    bound_s, rows = None, []
    for size in offsets_rad:
        start = _started_off(setup, size)
        summary = summarise(simulate(start).data())
        bound_s = summary["tracking"]["settling_bound_s"]
        times = summary["tracking"]["settling_time_s"]
        settled = None if None in times else max(times)
        offset = start.scenario.robot.initial_offset_rad
        rows.append(SettlingRow(offset, settled, bool(summary["bounds"]["kept"])))
    return SettlingTest(setup.scenario.controller.law, bound_s, rows)


def _started_off(setup: Setup, size_rad: float) -> Setup:
    scenario = setup.scenario
    side = np.where(
        np.broadcast_to(scenario.robot.initial_offset_rad, setup.robot.joints) < 0, -1, 1
    )
    target = setup.start_position_rad - scenario.robot.initial_offset_rad
    fits = (target + side * size_rad <= setup.robot.upper_rad) & (
        target + side * size_rad >= setup.robot.lower_rad
    )
    robot = scenario.robot.model_copy(
        update={"initial_offset_rad": np.where(fits, side, -side) * size_rad}
    )
    changes = {"robot": robot, "duration_s": min(_DURATION_S, math.ceil(scenario.duration_s))}
    return check(scenario.model_copy(update=changes), setup.source)

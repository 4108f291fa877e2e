"""Test of fixed-time convergence: settling times for small and large errors, against one bound."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydantic import TypeAdapter

from deploy.judge.run_rows import Row, held
from deploy.scenario.setup import Setup

OFFSETS_RAD = (0.01, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 1.0)
LONGEST_S = 8.0
"""Duration of the run from each start, unless the scenario ends earlier."""


@dataclass(frozen=True)
class Start:
    """One start.

    Attributes:
        offset_rad: initial error of each joint.
        settling_time_s: when the last joint entered the funnel's final bound to stay; None if not.
        bounds_kept: whether its verdict is that it kept its bounds.
    """

    offset_rad: list[float]
    settling_time_s: float | None
    bounds_kept: bool

    @property
    def distance_rad(self) -> float:
        """The largest initial error of a joint."""
        return max(map(abs, self.offset_rad))


@dataclass(frozen=True)
class SettlingTest:
    """All starts of one law.

    Attributes:
        law: its name.
        bound_s: the bound for every start; None for a law without one.
    """

    law: str
    bound_s: float | None
    starts: list[Start]

    @property
    def holds(self) -> bool:
        """Whether there is a bound and every start settled within it."""
        times = [start.settling_time_s for start in self.starts]
        bound = self.bound_s
        return bound is not None and all(time is not None and time <= bound for time in times)


SETTLING = TypeAdapter(list[SettlingTest])
"""Converter of settling tests from and to ``summary.json``."""


def settling_test(law: str, starts: Sequence[tuple[list[float], Row]]) -> SettlingTest:
    """Return the results of a law's starts: the offset of each, and the row of its run."""
    bounds = [bound for _, row in starts for bound in row["settling_bound_s"] or ()]
    return SettlingTest(law, max(bounds, default=None), [_start(*each) for each in starts])


def _start(offset_rad: list[float], row: Row) -> Start:
    times = row["settling_time_s"] or [None]
    settled = max(times) if row["completed"] and None not in times else None
    return Start(offset_rad, settled, held(row))


def offset_of(setup: Setup, size_rad: float) -> list[float]:
    """Return the initial error of each joint at a distance, rad.

    Every joint has an error of the same size, on the side of the scenario's own offset; if its
    range ends before, on the other side, or as large as possible. The funnel opens with the offset,
    as in the scenario.
    """
    robot = setup.robot
    own = np.broadcast_to(setup.scenario.robot.initial_offset_rad, robot.joints)
    target = setup.start_position_rad - own
    side = np.where(own < 0, -1, 1)
    room = np.where(side > 0, robot.upper_rad - target, target - robot.lower_rad)
    other_room = np.where(side > 0, target - robot.lower_rad, robot.upper_rad - target)
    turned = (room < size_rad) & (other_room > room)
    reach = np.minimum(np.where(turned, other_room, room), size_rad)
    offsets: list[float] = (np.where(turned, -side, side) * reach).tolist()
    return offsets

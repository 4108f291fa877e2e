"""The response of a robot whose inner law is unpublished: a dead time, then second order."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from bus_schema.arrays import Matrix, Vector
from plant_emulator.interfaces.interface import Motion


class Response:
    """Critically damped motion towards positions, exact for positions that stay for a cycle.

    At a constant speed, it is behind by the dead time, the lag and, as targets stay for a cycle,
    half of that.

    Args:
        period_s: of a cycle.
        dead_s: time in which nothing happens, in whole cycles.
        lag_s: how long it is behind at a constant speed; 0 for joints that follow at once.
    """

    def __init__(self, period_s: float, dead_s: float, lag_s: float) -> None:
        self._period_s, self._cycles = period_s, round(dead_s / period_s)
        self._bandwidth_rad_s = 2.0 / lag_s if lag_s > 0.0 else 0.0

    def start(self, position_rad: Vector) -> None:
        """Begin at rest."""
        self.position, self.velocity = position_rad.copy(), np.zeros(position_rad.size)
        at_rest = np.stack([position_rad, self.velocity])
        self._waiting: deque[Matrix] = deque(at_rest.copy() for _ in range(self._cycles))

    def step(self, target: Matrix) -> Motion:
        """Return the motion of this cycle towards a target: position and velocity as rows."""
        self._waiting.append(target.copy())
        wanted, velocity = self._waiting.popleft()
        if not (w := self._bandwidth_rad_s):
            acceleration = np.zeros_like(wanted)
            self.position, self.velocity = wanted, velocity
            return Motion(wanted.copy(), velocity.copy(), acceleration)
        away = self.position - wanted
        t, decay = self._period_s, math.exp(-w * self._period_s)
        slope = self.velocity + w * away
        then = (self.velocity - w * slope * t) * decay
        motion = Motion(self.position, self.velocity, (then - self.velocity) / t)
        self.position = wanted + (away + slope * t) * decay
        self.velocity = then
        return motion

"""Joints that follow velocities: each is reached over a cycle, at constant acceleration."""

from __future__ import annotations

import numpy as np

from bus_schema.arrays import Vector
from plant_emulator.interfaces.interface import Motion


class VelocityIntegrator:
    """Motion of joints from changes of their velocities.

    Args:
        period_s: of a cycle.

    Attributes:
        position: rad, shape (joints,), at the next cycle; velocity: rad/s, likewise.
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s

    def start(self, position_rad: Vector) -> None:
        """Begin at rest."""
        self.position, self.velocity = position_rad.copy(), np.zeros(position_rad.size)

    def change(self, change_rad_s: Vector) -> Motion:
        """Return the motion of a cycle over which velocities change by this much."""
        period_s = self._period_s
        motion = Motion(self.position, self.velocity, change_rad_s / period_s)
        self.position = self.position + period_s * (self.velocity + 0.5 * change_rad_s)
        self.velocity = self.velocity + change_rad_s
        return motion

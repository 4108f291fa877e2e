"""A policy that knows its task: the demonstrator of drawn tasks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bus_schema.arrays import Matrix, Vector
from controller.control_law import Diagnostics, Tracking


class Demonstrator:
    """A policy whose actions are the next ones of the reference.

    From the position that it observes, they return to the reference. Its settings are in
    ``controller.gains.custom``.

    Args:
        model: the arm.
        actions: number of actions in an answer.
        period_s: time between two of them.
        return_s: time in which an observed error falls to 1/e.
        lead_s: how far ahead of the reference it acts; by default the lag of the robot's own
            controller. What is missing shows in the error, and again in each answer: the actions
            begin at the position that it observes.
    """

    def __init__(
        self, model: Any, actions: int = 16, period_s: float = 0.04, return_s: float = 0.3,
        lead_s: float | None = None,
    ) -> None:  # fmt: skip
        self.diagnostics = Diagnostics(model.joints)
        self._ahead_s: Vector = period_s * np.arange(actions, dtype=np.float64)
        self._return_s, self._lead_s = return_s, lead_s

    @staticmethod
    def acts_ahead(gains: Mapping[str, Any]) -> bool:
        """Whether an instance with these settings makes up for the robot's lag."""
        return gains.get("lead_s") is None

    def make_up_for(self, lag_s: float) -> None:
        """Act ahead by the lag of the robot's own controller, unless a lead is given."""
        if self._lead_s is None:
            self._lead_s = lag_s

    def reset(self) -> None:
        """Do nothing: it remembers nothing."""

    def torque(self, tracking: Tracking) -> Vector:
        """Return zero torques: a drive loop or the robot's own makes them."""
        return np.zeros_like(tracking.error)

    def target(self, tracking: Tracking) -> Matrix:
        """Return its actions, positions and velocities of shape (actions, 2, joints)."""
        times_s: Vector = tracking.time_s + (self._lead_s or 0.0) + self._ahead_s
        actions = tracking.reference_at(times_s)
        left = np.exp(-self._ahead_s / self._return_s)[:, np.newaxis] * tracking.error
        actions[:, 0] += left
        actions[:, 1] -= left / self._return_s
        return actions

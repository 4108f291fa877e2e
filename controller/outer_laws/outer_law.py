"""Base of laws that give targets instead of torques."""

from __future__ import annotations

import numpy as np

from bus_schema.arrays import Matrix, Vector
from controller.control_law import Diagnostics, Tracking
from controller.reference import Reference


class OuterLaw:
    """A law without torque.

    Args:
        joints: number of joints.

    Attributes:
        diagnostics: its internal state.
    """

    def __init__(self, joints: int) -> None:
        self.diagnostics = Diagnostics(joints)
        self._torque: Vector = np.zeros(joints)
        self._target: Matrix = np.zeros((2, joints))
        self._ahead: Matrix = np.zeros((3, joints))
        self._preview_s = 0.0
        self._reference: Reference | None = None

    def follow(self, reference: Reference, preview_s: float) -> None:
        """Read a reference ahead of a state.

        Args:
            reference: positions that the robot follows.
            preview_s: how far ahead of a state it is read.
        """
        self._reference, self._preview_s = reference, preview_s

    def reset(self) -> None:
        """Forget everything."""

    def torque(self, tracking: Tracking) -> Vector:  # noqa: ARG002
        """Return zeros: the robot's own controller finds its torques."""
        return self._torque

    def ahead(self, tracking: Tracking) -> Matrix:
        """Return the previewed reference: position, velocity, acceleration; shape (3, joints)."""
        ahead, time_s = self._ahead, tracking.time_s + self._preview_s
        if self._reference is not None and self._preview_s:
            self._reference.evaluate(time_s, *ahead)
        else:
            ahead[0], ahead[1] = tracking.reference_position, tracking.reference_velocity
            ahead[2] = tracking.reference_acceleration
        return ahead

"""Where the joints of an arm stand in a library's own lists, and what follows them there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector


class JointPlaces:
    """Values per driven joint, in the URDF's order, and per moving joint, in the library's.

    Mimic joints move with the joints that they follow: q = S q_driven + o, with constant S. So
    torques come back as Sᵀ τ, and matrices as Sᵀ M S.

    Args:
        order: place of each driven joint in the library's lists, shape (joints,).
        followers: place, number of the driven joint, multiplier and offset of each mimic joint.

    Attributes:
        order: as above.
        couples: whether any joint follows another one.
    """

    def __init__(
        self, order: NDArray[np.int64], followers: list[tuple[int, int, float, float]]
    ) -> None:
        self.order = order
        self.couples = bool(followers)
        joints, total = order.size, order.size + len(followers)
        self._sorting = np.argsort(order)
        self._spread: Matrix = np.zeros((total, joints))
        self._spread[order, np.arange(joints)] = 1.0
        self._offset: Vector = np.zeros(total)
        for place, leader, multiplier, offset in followers:
            self._spread[place, leader] = multiplier
            self._offset[place] = offset
        # Symmetric matrices have their upper triangle filled.
        self._upper = (np.minimum.outer(order, order), np.maximum.outer(order, order))

    def positions(self, position: Vector) -> Vector:
        """Positions of all joints in the library's order."""
        if not self.couples:
            return position[self._sorting]
        return np.asarray(self._spread @ position + self._offset)

    def rates(self, values: Vector) -> Vector:
        """Velocities or accelerations of all joints in the library's order."""
        return np.asarray(self._spread @ values) if self.couples else values[self._sorting]

    def torques(self, full: Vector) -> Vector:
        """Torques as the driven joints feel them, shape (joints,)."""
        return np.ascontiguousarray(self._spread.T @ full if self.couples else full[self.order])

    def square(self, full: Matrix) -> Matrix:
        """A matrix between velocities and torques, shape (joints, joints)."""
        if self.couples:
            return np.asarray(self._spread.T @ full @ self._spread)
        return np.ascontiguousarray(full[np.ix_(self.order, self.order)])

    def symmetric(self, full: Matrix) -> Matrix:
        """The same for a symmetric one of which the upper triangle is filled."""
        if self.couples:
            return self.square(np.triu(full) + np.triu(full, 1).T)
        return np.asarray(full[self._upper])

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
        self._joints, total = order.size, order.size + len(followers)
        # S has one number in each row: which joint moves this one, and how many times as far.
        self._leader = np.empty(total, dtype=np.int64)
        self._leader[order] = np.arange(order.size)
        self._factor: Vector = np.ones(total)
        self._offset: Vector = np.zeros(total)
        for place, leader, multiplier, offset in followers:
            self._leader[place], self._factor[place] = leader, multiplier
            self._offset[place] = offset
        self._pairs = (self._joints * self._leader[:, None] + self._leader).ravel()
        # Symmetric matrices have their upper triangle filled.
        self._upper = (np.minimum.outer(order, order), np.maximum.outer(order, order))

    def positions(self, position: Vector) -> Vector:
        """Positions of all joints in the library's order."""
        moved = self.rates(position)
        return moved + self._offset if self.couples else moved

    def rates(self, values: Vector) -> Vector:
        """Velocities or accelerations of all joints in the library's order."""
        moved = values[self._leader]
        return moved * self._factor if self.couples else moved

    def torques(self, full: Vector) -> Vector:
        """Torques as the driven joints feel them, shape (joints,)."""
        if self.couples:  # not by @, which rounds as BLAS does on this CPU
            return np.asarray(np.bincount(self._leader, full * self._factor, self._joints), float)
        return full[self.order]

    def square(self, full: Matrix) -> Matrix:
        """A matrix between velocities and torques, shape (joints, joints)."""
        if self.couples:
            felt = self._factor[:, None] * full * self._factor
            total = np.bincount(self._pairs, felt.ravel(), self._joints**2)
            return np.asarray(total, float).reshape(self._joints, self._joints)
        return np.ascontiguousarray(full[np.ix_(self.order, self.order)])

    def symmetric(self, full: Matrix) -> Matrix:
        """The same for a symmetric one of which the upper triangle is filled."""
        if self.couples:
            return self.square(np.triu(full) + np.triu(full, 1).T)
        return np.asarray(full[self._upper])

"""A linear law: torques from the positions and velocities of this tick and of earlier ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bus_schema.arrays import Matrix, Vector

ENDED = 1e-7
"""Of the largest response: what is below is no response."""
_MOST_POLES = 8
_IS_INTEGRAL = 1e-6


@dataclass(frozen=True)
class LinearLaw:
    """u_k = Σ N_j y_(k−j) − Σ a_i u_(k−i), with y = (positions, velocities).

    Attributes:
        taps: N_0, N_1, …, shape (ticks, joints, 2 joints), N m per rad and rad/s.
        recursion: a_1, a_2, …, shape (poles,): integrals and filters.
    """

    taps: Any
    recursion: Vector

    @property
    def states(self) -> int:
        """Number of states of `realisation`."""
        return int(self.taps.shape[1]) * max(len(self.taps) - 1, len(self.recursion))

    def transfer(self, z: Any) -> Any:
        """Return the transfer matrix at these points, shape (points, joints, 2 joints)."""
        past = z[:, None] ** -np.arange(max(len(self.taps), len(self.recursion) + 1))
        numerator = np.tensordot(past[:, : len(self.taps)], self.taps, 1)
        denominator = 1.0 + past[:, 1 : len(self.recursion) + 1] @ self.recursion
        return numerator / denominator[:, None, None]

    def torques(self, measured: Matrix) -> Matrix:
        """Return the torques for a motion, shapes (ticks, 2 joints) and (ticks, joints)."""
        found = np.zeros((len(measured), self.taps.shape[1]))
        for k in range(len(measured)):
            for tap, seen in zip(self.taps, measured[k::-1], strict=False):
                found[k] += tap @ seen
            for factor, earlier in zip(self.recursion, found[:k][::-1], strict=False):
                found[k] -= factor * earlier
        return found

    def realisation(self) -> tuple[Any, Any, Any, Any]:
        """Return A, B, C, D of s_(k+1) = A s_k + B y_k, u_k = C s_k + D y_k."""
        joints = self.taps.shape[1]
        order = self.states // joints
        taps = np.zeros((order + 1, *self.taps.shape[1:]))
        taps[: len(self.taps)] = self.taps
        factors = np.zeros(order)
        factors[: len(self.recursion)] = self.recursion
        shift = np.eye(order, k=1)
        shift[:, :1] -= factors[:, None]
        later = taps[1:] - factors[:, None, None] * taps[0]
        into = later.reshape(order * joints, 2 * joints)
        return np.kron(shift, np.eye(joints)), into, np.eye(joints, order * joints), taps[0]


def fitted(responses: Any) -> tuple[int, Vector] | None:
    """Return the shortest recursion with which responses to an impulse end, and after how long.

    Args:
        responses: from the tick of the impulse on, shape (ticks, channels).

    Returns:
        A number of ticks after which the response has ended, and the recursion; None if it does not
        end.
    """
    largest = abs(responses).max(axis=0)
    heard = responses[:, largest > 0.0] / largest[largest > 0.0]
    begin = 1
    while len(heard) - begin >= begin // 2:  # it has to be over for half as long as it lasted
        for poles in range(_MOST_POLES + 1):
            if (recursion := _recursion(heard[begin:], poles)) is not None:
                return begin + poles, recursion
        begin *= 2
    return None


def filtered(responses: Any, recursion: Vector) -> Any:
    """Return Σ a_i x_(k−i) with a_0 = 1, along the first axis."""
    found = np.array(responses)
    for i, factor in enumerate(recursion.tolist(), start=1):
        found[i:] += factor * responses[:-i]
    return found


def _recursion(tail: Matrix, poles: int) -> Vector | None:
    """Return a recursion of an order that a tail follows, shape (poles,); None if none does."""
    recursion: Any = np.zeros(poles)
    if poles:
        ticks = len(tail) - poles
        earlier = np.stack([tail[poles - i :][:ticks].ravel() for i in range(1, poles + 1)], 1)
        roots = np.roots([1.0, *np.linalg.lstsq(-earlier, tail[poles:].ravel())[0]])
        recursion = np.poly(np.where(abs(roots - 1.0) < _IS_INTEGRAL, 1.0, roots)).real[1:]
    left = filtered(tail, recursion)[poles:]
    return recursion if abs(left).max() <= ENDED else None

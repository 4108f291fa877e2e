"""Linear loops with delays, computed without the product: exact discretisation and eigenvalues.

A plant ẋ = A x + B u is sampled with period h; u_k = −K (x_k, z_k) acts from t_k + d_k on, where
z_k = h (x_0 + … + x_k) are sums for an integral action, until a later one does.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np


@dataclass(frozen=True)
class LinearLoop:
    """A plant and a law: `gains` over the states, `integral` over their sums."""

    dynamics: np.ndarray
    inputs: np.ndarray
    gains: np.ndarray
    integral: np.ndarray
    period_s: float

    def growth_per_s(self, delays_s) -> float:
        """Return the rate of growth with delays that repeat, one for each sample.

        It is the logarithm of the spectral radius of the transition over all of them. Messages must
        arrive in order.
        """
        h, count = self.period_s, len(delays_s)
        most = max(int(np.ceil(max(delays_s) / h - 1e-9)), 1) + 1
        total = np.eye(self._size(most))
        for k in range(count):
            total = self._over_a_period(self._in_force(delays_s, k, most), most) @ total
        return float(np.log(max(abs(np.linalg.eigvals(total)))) / (count * h))

    def is_stable(self, delays_s) -> bool:
        """Whether the loop is stable with delays that repeat, one for each sample."""
        return self.growth_per_s(delays_s) < 0.0

    def exact_margin_s(self, resolution_s: float = 1e-5, scan_s: float = 5e-4) -> float:
        """Smallest constant delay at which the loop becomes unstable."""
        assert self.is_stable([0.0])
        below = 0.0
        while self.is_stable([below + scan_s]):
            below += scan_s
        above = below + scan_s
        while above - below > resolution_s:
            middle = 0.5 * (below + above)
            below, above = (middle, above) if self.is_stable([middle]) else (below, middle)
        return below

    @property
    def _summing(self) -> np.ndarray:
        """Rows of the integral action that are not zero, times the period."""
        return self.period_s * self.integral[self.integral.any(axis=1)]

    def _size(self, most: int) -> int:
        states, torques = self.inputs.shape
        return states + len(self._summing) + (most + 1) * torques

    def _in_force(self, delays_s, k: int, most: int) -> list[tuple[float, float, int]]:
        """Parts of period k, as begin, end, and how many periods ago their torque was computed."""
        h, count = self.period_s, len(delays_s)
        arrivals = [(delays_s[(k - age) % count] - age * h, age) for age in range(most + 1)]
        edges = sorted({0.0, h, *(t for t, _ in arrivals if 0.0 < t < h - 1e-12)})
        return [
            (begin, end, min(age for t, age in arrivals if t <= begin + 1e-12))
            for begin, end in zip(edges, edges[1:], strict=False)
        ]

    def _over_a_period(self, parts, most: int) -> np.ndarray:
        """Transition from (x, integral actions, torques of the last periods) to the next."""
        h, (states, torques) = self.period_s, self.inputs.shape
        size, summing = self._size(most), self._summing
        past = states + len(summing)
        answer = np.zeros((torques, size))
        answer[:, :states] = -self.gains - self.period_s * self.integral
        answer[self.integral.any(axis=1), states:past] = -np.eye(len(summing))
        row = np.eye(size)
        ages = [answer, *(row[past + i * torques :][:torques] for i in range(most + 1))]
        step = np.zeros((size, size))
        step[:states, :states] = exponential(self.dynamics, h)
        for begin, end, age in parts:
            step[:states] += self._held(h - end, h - begin) @ ages[age]
        step[states:past] = row[states:past]
        step[states:past, :states] = summing
        step[past : past + torques] = answer
        step[past + torques :] = row[past:-torques]
        return step

    def _held(self, begin: float, end: float) -> np.ndarray:
        """∫ exp(A s) B ds."""
        states, torques = self.inputs.shape
        both = np.zeros((states + torques, states + torques))
        both[:states, :states], both[:states, states:] = self.dynamics, self.inputs
        until = [exponential(both, time_s)[:states, states:] for time_s in (begin, end)]
        return until[1] - until[0]


def exponential(matrix: np.ndarray, time_s: float) -> np.ndarray:
    """Matrix exponential, by squaring a Taylor polynomial."""
    return _exponential(matrix.tobytes(), len(matrix), time_s)


@lru_cache(maxsize=10_000)
def _exponential(matrix: bytes, size: int, time_s: float) -> np.ndarray:
    small = np.frombuffer(matrix).reshape(size, size) * (time_s / 2**12)
    result = term = np.eye(size)
    for order in range(1, 8):
        term = term @ small / order
        result = result + term
    return np.linalg.matrix_power(result, 2**12)


def rigid(
    mass_matrix, proportional, derivative, integral, period_s, viscous=0.0, stiffness=0.0
) -> LinearLoop:
    """Joints with a constant mass matrix, friction and springs under PID; gains per joint."""
    joints = len(mass_matrix)
    dynamics, inputs = np.zeros((2 * joints, 2 * joints)), np.zeros((2 * joints, joints))
    dynamics[:joints, joints:] = np.eye(joints)
    inputs[joints:] = np.linalg.inv(mass_matrix)
    dynamics[joints:] = -inputs[joints:] @ np.eye(joints, 2 * joints) * stiffness
    dynamics[joints:, joints:] -= viscous * inputs[joints:]
    none = np.zeros((joints, joints))
    gains = np.hstack([np.diag(proportional), np.diag(derivative)])
    return LinearLoop(dynamics, inputs, gains, np.hstack([np.diag(integral), none]), period_s)


def geared(
    rotor, link, stiffness, damping, proportional, derivative, integral, period_s, *, viscous=0.0,
    is_seen_at_link=False,
):  # fmt: skip
    """One joint with an elastic gear, driven at the rotor, which has the friction."""
    dynamics = np.zeros((4, 4))  # rotor, link, and their rates
    dynamics[:2, 2:] = np.eye(2)
    for row, (mass, sign) in enumerate([(rotor, 1.0), (link, -1.0)]):
        dynamics[2 + row] = sign / mass * np.array([-stiffness, stiffness, -damping, damping])
    dynamics[2, 2] -= viscous / rotor
    inputs = np.array([[0.0], [0.0], [1.0 / rotor], [0.0]])
    seen = np.eye(4)[[1, 3] if is_seen_at_link else [0, 2]]
    gains, sums = np.array([[proportional, derivative]]), np.array([[integral, 0.0]])
    return LinearLoop(dynamics, inputs, gains @ seen, sums @ seen, period_s)


def lagging(loop: LinearLoop, lag_s: float) -> LinearLoop:
    """The loop with torques that follow what is asked for with a time constant."""
    states, torques = loop.inputs.shape
    still = np.zeros((torques, states))
    own = np.eye(torques) / lag_s
    return LinearLoop(
        np.block([[loop.dynamics, loop.inputs], [still, -own]]),
        np.vstack([0.0 * loop.inputs, own]),
        np.hstack([loop.gains, 0.0 * own]),
        np.hstack([loop.integral, 0.0 * own]),
        loop.period_s,
    )

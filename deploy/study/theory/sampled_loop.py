"""A linear plant under a linear law that is sampled with period h, and held.

A torque computed from the state at t_k acts from t_k + d on, until the next one does. With
d = (n + f) h, f below 1, the states follow

    x_(k+1) = Φ x_k + Γ_new(f) u_(k−n) + Γ_old(f) u_(k−n−1),

so that at z = exp(s h) the loop is u = z^(−n) R_f(z) u. See Åström and Wittenmark, "Computer-
Controlled Systems", section 2.3.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from bus_schema.arrays import Matrix, Vector
from deploy.study.theory.linear_law import LinearLaw
from deploy.study.theory.linear_plant import LinearPlant

SLOWEST = 1e-6
"""Smallest angle of a response, and growth per period that counts as stable."""
_SHARPEST = 64
_AROUND = np.geomspace(0.05, 50.0, 24)
_AROUND = np.array([*-_AROUND[::-1], *_AROUND])
"""Distances from a pole's angle, in those of the pole from the circle."""
_TERMS = 16
"""Of the exponential's series, for matrices with a norm of at most ½."""


class SampledLoop:
    """A loop for frequency responses and its transition matrix.

    Attributes:
        plant: the arm.
        law: the law.
        period_s: h.
        transition: Φ, shape (states, states).
    """

    def __init__(self, plant: LinearPlant, law: LinearLaw, period_s: float) -> None:
        self.plant, self.law, self.period_s = plant, law, period_s
        self.transition, self._held = self._over(period_s)

    def answers(self, z: Any) -> Any:
        """Return the torques that answer a change of the states, at these points.

        Shape (points, joints, states).
        """
        left = z[:, None, None] * np.eye(len(self.transition)) - self.transition
        seen = self.law.transfer(z) @ self.plant.outputs
        return np.linalg.solve(left.transpose(0, 2, 1), seen.transpose(0, 2, 1)).transpose(0, 2, 1)

    def ratios(self, z: Any, answers: Any, fraction: float) -> Any:
        """Return R_f at points where the answers are known, shape (points, joints, joints)."""
        new, old = self._parts(fraction)
        return answers @ (new + old / z[:, None, None])

    @cached_property
    def roots(self) -> tuple[Any, Any]:
        """Roots without a delay, shape (roots,), and what the states do there, as columns."""
        a, b, c, d = self.law.realisation()
        outputs, held, states = self.plant.outputs, self._held, len(self.transition)
        whole = np.block([[self.transition + held @ d @ outputs, held @ c], [b @ outputs, a]])
        values, shapes = np.linalg.eig(whole)
        return values, shapes[:states]

    @property
    def peaks(self) -> Vector:
        """Angles of z at which responses are largest: those of the plant's resonances, and π."""
        poles = np.linalg.eigvals(self.transition)
        return np.array([*(np.angle(poles[poles.imag > 0.0]) * (1.0 - 1e-9)), np.pi])

    @cached_property
    def angles(self) -> Vector:
        """Angles of z from 0 to π, close where responses change fast: at poles and roots."""
        poles = [
            *np.linalg.eigvals(self.transition), *np.roots([1.0, *self.law.recursion]),
            *self.roots[0],
        ]  # fmt: skip
        upper = (z for z in poles if z.imag >= 0.0)
        sharp = sorted(upper, key=lambda z: abs(1.0 - abs(z)))[:_SHARPEST]
        near = [np.angle(z) + (abs(1.0 - abs(z)) + 1e-9) * _AROUND for z in sharp]
        even = np.linspace(0.0, np.pi, 64 + 8 * len(self.law.taps))
        found = np.concatenate([np.geomspace(SLOWEST, np.pi, 400), even, *near])
        return np.unique(found[(found >= SLOWEST) & (found <= np.pi)])

    def fastest_growth(self) -> tuple[complex, int]:
        """Return growth and frequency without a delay, 1/s and rad/s, and the joint."""
        values, shapes = self.roots
        fastest = np.argmax(abs(values))
        return complex(np.log(values[fastest]) / self.period_s), self._joint(shapes[:, fastest])

    def moving_most(self, angle: float, delay_s: float) -> int:
        """Return the joint that moves most in the oscillation at an angle that a delay begins."""
        z, (whole, rest) = np.exp(1j * np.array([angle])), divmod(delay_s, self.period_s)
        fraction = rest / self.period_s
        values, shapes = np.linalg.eig(self.ratios(z, self.answers(z), fraction)[0])
        torques = shapes[:, np.argmin(abs(values - z**whole))]
        new, old = self._parts(fraction)
        left = z * np.eye(len(self.transition)) - self.transition
        return self._joint(np.linalg.solve(left, (new + old / z) @ torques))

    def _joint(self, states: Any) -> int:
        joints = self.plant.inputs.shape[1]
        return int(np.argmax(abs(self.plant.outputs[:joints] @ states)))

    def _parts(self, fraction: float) -> tuple[Matrix, Matrix]:
        """Return Γ_new and Γ_old."""
        new = self._over((1.0 - fraction) * self.period_s)[1]
        return new, self._held - new

    def _over(self, time_s: float) -> tuple[Matrix, Matrix]:
        """Return exp(A t) and ∫ exp(A s) B ds."""
        dynamics, inputs = self.plant.dynamics, self.plant.inputs
        states, joints = inputs.shape
        both = np.zeros((states + joints, states + joints))
        both[:states, :states], both[:states, states:] = dynamics, inputs
        moved = exponential(both * time_s)[:states]
        return moved[:, :states], moved[:, states:]


def exponential(matrix: Matrix) -> Matrix:
    """Return the matrix exponential, by squaring that of a small share."""
    norm = float(np.linalg.norm(matrix, 1))
    squarings = max(0, int(np.ceil(np.log2(2.0 * norm)))) if norm > 0.0 else 0
    small, total = matrix / 2.0**squarings, np.eye(len(matrix))
    for term in range(_TERMS, 0, -1):
        total = np.eye(len(matrix)) + small @ total / term
    for _ in range(squarings):
        total = total @ total
    return total

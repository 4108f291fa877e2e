"""A linear plant under a linear law that is sampled with period h, and held.

A torque computed from the state at t_k acts from t_k + d on, until the next one does. With
d = (n + f) h, f below 1, the states follow

    x_(k+1) = Φ x_k + Γ_new(f) u_(k−n) + Γ_old(f) u_(k−n−1),

so that at z = exp(s h) the loop is u = z^(−n) R_f(z) u. See Åström and Wittenmark, "Computer-
Controlled Systems", section 2.3.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bus_schema.arrays import Matrix
from deploy.study.theory.linear_law import LinearLaw
from deploy.study.theory.linear_plant import LinearPlant

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

    def closed(self) -> Matrix:
        """Return the transition of (plant, law) over a period without delay."""
        a, b, c, d = self.law.realisation()
        outputs, held = self.plant.outputs, self._held
        return np.block([
            [self.transition + held @ d @ outputs, held @ c],
            [b @ outputs, a],
        ])  # fmt: skip

    def oscillation(self, angle: float, delay_s: float) -> Any:
        """Return the states of the oscillation at an angle that begins at a delay."""
        z, (whole, rest) = np.exp(1j * np.array([angle])), divmod(delay_s, self.period_s)
        ratio = self.ratios(z, self.answers(z), rest / self.period_s)[0]
        values, shapes = np.linalg.eig(ratio)
        torques = shapes[:, np.argmin(abs(values - z**whole))]
        new, old = self._parts(rest / self.period_s)
        left = z * np.eye(len(self.transition)) - self.transition
        return np.linalg.solve(left, (new + old / z) @ torques)

    def moving_most(self, states: Any) -> int:
        """Return the joint with the largest measured position."""
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

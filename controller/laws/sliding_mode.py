"""What the sliding mode rivals of the paper's section 5 share: all but their surface.

    s = ė + σ(e),    τ = Ĉ q̇ + Ĝ + M̂ (q̈_d − σ′(e) ė − K sign s − k s),
    σ(e) = α sig(e)^φ + β sig(e)^ψ,  φ ≥ 1, 0 < ψ < 1.

Below |e| = η the power ψ is continued by a quadratic of equal value and slope (see
`surface_pull`), which bounds the slope that is infinite at zero.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.runtime.compiled import compiled
from controller.control_law import Diagnostics, Dynamics, Tracking
from controller.laws.sliding_surface import surface_pull, surface_pull_slope, switch


class Surface(NamedTuple):
    """The gains of σ; α and β per joint, shape (joints,)."""

    alpha: Vector
    beta: Vector
    phi: float = 1.0
    psi: float = 0.5
    eta: float = 1e-3


class Reaching(NamedTuple):
    """Switching gain K (rad/s²) and linear gain k (1/s), shape (joints,); boundary layer (rad/s).

    Inside ±boundary_layer the sign gives way to a straight line; 0 for none.
    """

    switching: Vector
    linear: Vector
    boundary_layer: float


class SwitchingLaw:
    """A law that slides on a surface σ, on a nominal model."""

    def __init__(self, surface: Surface, reaching: Reaching, model: Dynamics) -> None:
        joints = surface.beta.size
        self.diagnostics = Diagnostics(joints)
        self._surface = surface
        self._reaching = reaching
        self._model = model
        self._acceleration: Vector = np.zeros(joints)

    def reset(self) -> None:
        """Nothing to forget: the law has no memory."""

    def torque(self, tracking: Tracking) -> Vector:
        _acceleration(
            tracking.error,
            tracking.error_rate,
            tracking.reference_acceleration,
            self._surface,
            self._reaching,
            self.diagnostics.sliding_variable,
            self._acceleration,
        )
        return self._model.inverse_dynamics(
            tracking.position, tracking.velocity, self._acceleration
        )


@compiled
def _acceleration(
    error: Vector, error_rate: Vector, reference_acceleration: Vector,
    surface: Surface, reaching: Reaching, sliding: Vector, acceleration: Vector,
) -> None:  # fmt: skip
    alpha, beta, phi, psi, eta = surface
    gain, linear, layer = reaching
    for i in range(error.size):
        sigma = surface_pull(error[i], alpha[i], beta[i], phi, psi, eta)
        d_sigma = surface_pull_slope(error[i], alpha[i], beta[i], phi, psi, eta)
        s = error_rate[i] + sigma
        reach = gain[i] * switch(s, layer) + linear[i] * s
        acceleration[i] = reference_acceleration[i] - d_sigma * error_rate[i] - reach
        sliding[i] = s

"""The fixed-time model-based law: funnel, terminal sliding surface and a nominal model.

After section 3 of the paper (the law of its first theorem). The surface, divided by the slope r of
the error transformation, is s = q̇ − q̇_r for the reference velocity q̇_r = q̇_d + v − ψ(ε) / r, and

    τ = M̂ q̈_r + Ĉ q̇_r + Ĝ − K₁ sig(s)^γ₁ − K₂ sig(s)^γ₂ − K₃ s,
    q̈_r = q̈_d + v̇ − ψ′(ε) ε̇ / r + ψ(ε) ṙ / r².
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.configuration import PerJointNonNegative, Positive, PowerAboveOne, PowerBelowOne
from bus_schema.runtime.compiled import bind, compiled
from controller.control_law import Diagnostics, Dynamics, Tracking
from controller.funnel import (
    transform,
    transformation_accelerations,
    transformation_rates,
)
from controller.laws.reopening import working_bounds
from controller.laws.sliding_surface import sig, surface_pull, surface_pull_slope


class FixedTimeModelBasedGains(NamedTuple):
    """Gains, with the symbols of the equations; K₁, K₂ and K₃ per joint."""

    k_1: PerJointNonNegative
    k_2: PerJointNonNegative
    k_3: PerJointNonNegative
    alpha_1: Positive = 5.0
    alpha_2: Positive = 5.0
    phi_1: PowerAboveOne = 1.4
    phi_2: PowerBelowOne = 0.6
    gamma_1: PowerAboveOne = 1.4
    gamma_2: PowerBelowOne = 0.6
    eta: Positive = 0.02

    @classmethod
    def from_inertia(cls, inertia_kg_m2: Vector) -> FixedTimeModelBasedGains:
        """Return gains for joints with these inertias, shape (joints,).

        Without a network, feedback alone has to dominate the model's errors.
        """
        return cls(k_1=100.0 * inertia_kg_m2, k_2=100.0 * inertia_kg_m2, k_3=250.0 * inertia_kg_m2)


class _Memory(NamedTuple):
    """The law's state and intermediate values, in arrays that its kernel changes in place.

    All have shape (joints,).

    Attributes:
        opening: of the funnel, see `working_bounds`; rad.
        velocity: q̇_r; rad/s.
        acceleration: q̈_r; rad/s².
        reaching: K₁ sig(s)^γ₁ + K₂ sig(s)^γ₂ + K₃ s; N m.
    """

    opening: Vector
    velocity: Vector
    acceleration: Vector
    reaching: Vector


class FixedTimeModelBased:
    """The law on a nominal model."""

    def __init__(
        self, gains: FixedTimeModelBasedGains, model: Dynamics, _torque_limits_nm: Vector
    ) -> None:
        joints = gains.k_1.size
        self.diagnostics = Diagnostics(joints)
        self._gains = gains
        self._model = model
        self._memory = _Memory(*np.zeros((4, joints)))
        self._tracking: Tracking | None = None

    def reset(self) -> None:
        self._memory.opening[:] = 0.0

    def torque(self, tracking: Tracking) -> Vector:
        if tracking is not self._tracking:
            self._bind(tracking)
        self._kernel(tracking.step_s)
        _, velocity, acceleration, reaching = self._memory
        position = tracking.position
        along = self._model.torque_along(position, tracking.velocity, velocity, acceleration)
        return along - reaching

    def _bind(self, tracking: Tracking) -> None:
        """Bind the kernel's arguments: determining their types costs more than the work."""
        self._tracking = tracking
        self._kernel = bind(
            _reference_motion,
            tracking.error, tracking.error_rate, tracking.bounds,
            tracking.reference_velocity, tracking.reference_acceleration,
            self._gains, self._memory,
            self.diagnostics.transformed_error, self.diagnostics.sliding_variable,
            free=["float64"],
        )  # fmt: skip


@compiled
def _reference_motion(
    error: Vector, error_rate: Vector, bounds: Matrix,
    reference_velocity: Vector, reference_acceleration: Vector,
    gains: FixedTimeModelBasedGains, memory: _Memory,
    transformed: Vector, sliding: Vector, step_s: float,
) -> None:  # fmt: skip
    g, (opening, velocity, acceleration, reaching) = gains, memory
    for i in range(error.size):
        e, d_e = error[i], error_rate[i]
        upper, lower, opening[i] = working_bounds(e, bounds[:, i], step_s, opening[i])
        r, v = transformation_rates(e, upper, lower)
        d_r, d_v = transformation_accelerations(e, d_e, upper, lower)
        epsilon = transform(e, upper, lower)
        d_epsilon = r * (d_e - v)
        psi = surface_pull(epsilon, g.alpha_1, g.alpha_2, g.phi_1, g.phi_2, g.eta)
        d_psi = surface_pull_slope(epsilon, g.alpha_1, g.alpha_2, g.phi_1, g.phi_2, g.eta)

        velocity[i] = reference_velocity[i] + v - psi / r
        acceleration[i] = (
            reference_acceleration[i] + d_v - d_psi * d_epsilon / r + psi * d_r / (r * r)
        )
        s = d_e - v + psi / r
        reaching[i] = g.k_1[i] * sig(s, g.gamma_1) + g.k_2[i] * sig(s, g.gamma_2) + g.k_3[i] * s
        transformed[i], sliding[i] = epsilon, s

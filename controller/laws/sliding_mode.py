"""Sliding mode control on a nominal model: the three baselines of the paper's section 5.

    s = ė + σ(e),    τ = Ĉ q̇ + Ĝ + M̂ (q̈_d − σ′(e) ė − K sign s − k s).

They differ only in their surface:

    smc    σ(e) = λ e
    tsmc   σ(e) = β sig(e)^(q/p),  0 < q/p < 1                  (terminal)
    ftsmc  σ(e) = α sig(e)^φ + β sig(e)^ψ,  φ ≥ 1, 0 < ψ < 1    (fast terminal)

Below |e| = η a power below 1 is continued by a quadratic of equal value and slope (see
`surface_pull`), which bounds the slope that is infinite at zero. Inside ±boundary_layer (rad/s) the
sign becomes a straight line; 0 for none.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field

from bus_schema.arrays import Vector
from bus_schema.configuration import (
    NonNegative,
    Number,
    PerJointNonNegative,
    PerJointPositive,
    Positive,
    PowerBelowOne,
)
from bus_schema.runtime.compiled import compiled
from controller.control_law import Diagnostics, Dynamics, Tracking
from controller.laws.sliding_surface import surface_pull, surface_pull_slope

_LINEAR_PER_S = 10.0


class Surface(NamedTuple):
    """The gains of σ(e) = α sig(e)^φ + β sig(e)^ψ; α and β per joint, shape (joints,)."""

    alpha: Vector
    beta: Vector
    phi: float = 1.0
    psi: float = 0.5
    eta: float = 1e-3


class Reaching(NamedTuple):
    """Switching gain K (rad/s²) and linear gain k (1/s), shape (joints,); boundary layer."""

    switching: Vector
    linear: Vector
    boundary_layer: float


class SmcGains(NamedTuple):
    """Slope of the surface λ (1/s) per joint, and the gains of the reaching law."""

    slope: PerJointPositive
    switching: PerJointNonNegative
    linear: PerJointNonNegative
    boundary_layer: NonNegative = 0.0

    @classmethod
    def from_inertia(cls, inertia_kg_m2: Vector) -> SmcGains:
        """Return equal gains for all joints, as M̂ scales by inertia, except for the switching."""
        one = np.ones_like(inertia_kg_m2)
        return cls(8.0 * one, default_switching(inertia_kg_m2), _LINEAR_PER_S * one)

    @property
    def surface(self) -> Surface:
        return Surface(alpha=self.slope, beta=np.zeros_like(self.slope))


class TsmcGains(NamedTuple):
    """Surface gain β per joint, power q/p, width η of its regularisation, reaching law."""

    beta: PerJointPositive
    switching: PerJointNonNegative
    linear: PerJointNonNegative
    power: PowerBelowOne = 7.0 / 9.0
    eta: Positive = 1e-3
    boundary_layer: NonNegative = 0.0

    @classmethod
    def from_inertia(cls, inertia_kg_m2: Vector) -> TsmcGains:
        """As for `SmcGains`."""
        one = np.ones_like(inertia_kg_m2)
        return cls(4.0 * one, default_switching(inertia_kg_m2), _LINEAR_PER_S * one)

    @property
    def surface(self) -> Surface:
        return Surface(np.zeros_like(self.beta), self.beta, psi=self.power, eta=self.eta)


class FtsmcGains(NamedTuple):
    """Surface gains α and β per joint, powers, width η of ψ's regularisation, reaching law."""

    alpha: PerJointPositive
    beta: PerJointPositive
    switching: PerJointNonNegative
    linear: PerJointNonNegative
    phi: Annotated[Number, Field(ge=1)] = 1.0
    psi: PowerBelowOne = 7.0 / 9.0
    eta: Positive = 1e-3
    boundary_layer: NonNegative = 0.0

    @classmethod
    def from_inertia(cls, inertia_kg_m2: Vector) -> FtsmcGains:
        """As for `SmcGains`."""
        one = np.ones_like(inertia_kg_m2)
        switching = default_switching(inertia_kg_m2)
        return cls(3.0 * one, 2.0 * one, switching, _LINEAR_PER_S * one)

    @property
    def surface(self) -> Surface:
        return Surface(self.alpha, self.beta, self.phi, self.psi, self.eta)


def default_switching(inertia_kg_m2: Vector) -> Vector:
    """Return switching gains for joints with these inertias, shape (joints,), rad/s².

    They must exceed friction, disturbance and model errors, per inertia. Friction grows more slowly
    than inertia, so light joints need more; factor and power are ours, from three arms of 0.0005 to
    12 kg m².
    """
    gains: Vector = 9.0 / np.sqrt(np.sqrt(inertia_kg_m2))
    return gains


def default_stiffness(inertia_kg_m2: Vector) -> Vector:
    """Return stiffness per inertia for these joints, shape (joints,), 1/s².

    What the default switching is to exceed moves an error by 2.5 mrad against it.
    """
    return default_switching(inertia_kg_m2) / 0.0025


class SlidingMode:
    """The law on the surface that its gains describe; it has no memory."""

    def __init__(
        self, gains: SmcGains | TsmcGains | FtsmcGains, model: Dynamics, _torque_limits_nm: Vector
    ) -> None:
        self.diagnostics = Diagnostics(gains.linear.size)
        self._surface = gains.surface
        self._reaching = Reaching(gains.switching, gains.linear, gains.boundary_layer)
        self._model = model
        self._acceleration: Vector = np.zeros(gains.linear.size)

    def reset(self) -> None:
        """Do nothing: there is no state."""

    def torque(self, tracking: Tracking) -> Vector:
        _acceleration(
            tracking.error, tracking.error_rate, tracking.reference_acceleration,
            self._surface, self._reaching, self.diagnostics.sliding_variable, self._acceleration,
        )  # fmt: skip
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
        reach = gain[i] * _switch(s, layer) + linear[i] * s
        acceleration[i] = reference_acceleration[i] - d_sigma * error_rate[i] - reach
        sliding[i] = s


@compiled
def _switch(s: float, boundary_layer: float) -> float:
    """Return sign(s), or s / boundary_layer where |s| is less than that."""
    if s == 0.0:
        return 0.0
    if abs(s) < boundary_layer:
        return s / boundary_layer
    return math.copysign(1.0, s)

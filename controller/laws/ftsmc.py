"""Fast terminal sliding mode control: a rival of the paper's section 5, on a nominal model.

s = ė + α sig(e)^φ + β sig(e)^ψ,  φ ≥ 1, 0 < ψ < 1,    τ as in `sliding_mode`.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field

from bus_schema.arrays import Vector
from bus_schema.configuration import (
    NonNegative,
    PerJointNonNegative,
    PerJointPositive,
    Positive,
    PowerBelowOne,
)
from controller.control_law import Dynamics
from controller.laws.sliding_mode import Reaching, Surface, SwitchingLaw
from controller.laws.sliding_surface import default_switching


class FtsmcGains(NamedTuple):
    """Surface gains α and β per joint, powers, width η of ψ's regularisation; as in `Reaching`."""

    alpha: PerJointPositive
    beta: PerJointPositive
    switching: PerJointNonNegative
    linear: PerJointNonNegative
    phi: Annotated[float, Field(ge=1)] = 1.0
    psi: PowerBelowOne = 7.0 / 9.0
    eta: Positive = 1e-3
    boundary_layer: NonNegative = 0.0

    @classmethod
    def from_inertia(cls, inertia_kg_m2: Vector) -> FtsmcGains:
        """The same for all joints but for the switching, as M̂ already scales by inertia."""
        one = np.ones_like(inertia_kg_m2)
        return cls(
            alpha=3.0 * one,
            beta=2.0 * one,
            switching=default_switching(inertia_kg_m2),
            linear=10.0 * one,
        )


class Ftsmc(SwitchingLaw):
    """σ(e) = α sig(e)^φ + β sig(e)^ψ."""

    def __init__(self, gains: FtsmcGains, model: Dynamics) -> None:
        g = gains
        surface = Surface(g.alpha, g.beta, g.phi, g.psi, g.eta)
        super().__init__(surface, Reaching(g.switching, g.linear, g.boundary_layer), model)

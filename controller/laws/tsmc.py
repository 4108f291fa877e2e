"""Terminal sliding mode control: a rival of the paper's section 5, on a nominal model.

s = ė + β sig(e)^(q/p),  0 < q/p < 1,    τ as in `sliding_mode`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

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


class TsmcGains(NamedTuple):
    """Surface gain β per joint, power q/p, width η of its regularisation; rest as in `Reaching`."""

    beta: PerJointPositive
    switching: PerJointNonNegative
    linear: PerJointNonNegative
    power: PowerBelowOne = 7.0 / 9.0
    eta: Positive = 1e-3
    boundary_layer: NonNegative = 0.0

    @classmethod
    def from_inertia(cls, inertia_kg_m2: Vector) -> TsmcGains:
        """The same for all joints but for the switching, as M̂ already scales by inertia."""
        one = np.ones_like(inertia_kg_m2)
        return cls(beta=4.0 * one, switching=default_switching(inertia_kg_m2), linear=10.0 * one)


class Tsmc(SwitchingLaw):
    """σ(e) = β sig(e)^(q/p)."""

    def __init__(self, gains: TsmcGains, model: Dynamics) -> None:
        g = gains
        surface = Surface(np.zeros_like(g.beta), g.beta, psi=g.power, eta=g.eta)
        super().__init__(surface, Reaching(g.switching, g.linear, g.boundary_layer), model)

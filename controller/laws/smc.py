"""Sliding mode control on a linear surface: a rival of the paper's section 5, on a nominal model.

s = ė + λ e,    τ as in `sliding_mode`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.configuration import NonNegative, PerJointNonNegative, PerJointPositive
from controller.control_law import Dynamics
from controller.laws.sliding_mode import Reaching, Surface, SwitchingLaw
from controller.laws.sliding_surface import default_switching


class SmcGains(NamedTuple):
    """Slope of the surface λ (1/s) per joint; the rest as in `Reaching`."""

    slope: PerJointPositive
    switching: PerJointNonNegative
    linear: PerJointNonNegative
    boundary_layer: NonNegative = 0.0

    @classmethod
    def from_inertia(cls, inertia_kg_m2: Vector) -> SmcGains:
        """The same for all joints but for the switching, as M̂ already scales by inertia."""
        one = np.ones_like(inertia_kg_m2)
        return cls(slope=8.0 * one, switching=default_switching(inertia_kg_m2), linear=10.0 * one)


class Smc(SwitchingLaw):
    """σ(e) = λ e."""

    def __init__(self, gains: SmcGains, model: Dynamics) -> None:
        surface = Surface(alpha=gains.slope, beta=np.zeros_like(gains.slope))
        super().__init__(
            surface, Reaching(gains.switching, gains.linear, gains.boundary_layer), model
        )

"""The fixed-time terminal sliding surface in the transformed error.

After section 3 of the paper: two powers, one above and one below 1, so that the time to slide into
zero has a bound that does not depend on where the motion starts.
"""

from __future__ import annotations

import math

from bus_schema.arrays import Vector
from bus_schema.runtime.compiled import compiled


@compiled
def sig(x: float, power: float) -> float:
    """The signed power sign(x) |x|^p."""
    return math.copysign(abs(x) ** power, x)


@compiled
def surface_pull(
    transformed: float, alpha_1: float, alpha_2: float, phi_1: float, phi_2: float, eta: float
) -> float:
    """ψ(ε) = α₁ sig(ε)^φ₁ + α₂ χ(ε).

    χ is sig(ε)^φ₂, continued below |ε| = η by a quadratic of equal value and slope, because the
    power itself has no finite slope at zero.
    """
    size = abs(transformed)
    if size >= eta:
        chi = sig(transformed, phi_2)
    else:
        linear = (2.0 - phi_2) * eta ** (phi_2 - 1.0)
        quadratic = (phi_2 - 1.0) * eta ** (phi_2 - 2.0)
        chi = linear * transformed + quadratic * transformed * size
    return alpha_1 * sig(transformed, phi_1) + alpha_2 * chi


@compiled
def surface_pull_slope(
    transformed: float, alpha_1: float, alpha_2: float, phi_1: float, phi_2: float, eta: float
) -> float:
    """ψ′(ε)."""
    size = abs(transformed)
    if size >= eta:
        d_chi = phi_2 * size ** (phi_2 - 1.0)
    else:
        linear = (2.0 - phi_2) * eta ** (phi_2 - 1.0)
        quadratic = (phi_2 - 1.0) * eta ** (phi_2 - 2.0)
        d_chi = linear + 2.0 * quadratic * size
    slope: float = alpha_1 * phi_1 * size ** (phi_1 - 1.0) + alpha_2 * d_chi
    return slope


@compiled
def switch(s: float, boundary_layer: float) -> float:
    """sign(s), or s / boundary_layer where |s| is less than that."""
    if s == 0.0:
        return 0.0
    if abs(s) < boundary_layer:
        return s / boundary_layer
    return math.copysign(1.0, s)


def default_switching(inertia_kg_m2: Vector) -> Vector:
    """Switching gains for joints that see these inertias, shape (joints,), rad/s².

    They have to outweigh friction, disturbance and what the model misses, per inertia. Friction
    grows more slowly than inertia, so light joints need more; factor and power are ours, from three
    arms of 0.0005 to 12 kg m².
    """
    gains: Vector = 9.0 * inertia_kg_m2**-0.25
    return gains

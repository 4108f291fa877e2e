"""The fixed-time terminal sliding surface in the transformed error.

After section 3 of the paper: one power above and one below 1, so that the time to slide to zero has
a bound independent of the initial error.
"""

from __future__ import annotations

import math

from bus_schema.runtime.compiled import compiled


@compiled
def sig(x: float, power: float) -> float:
    """Return the signed power sign(x) |x|^p."""
    return math.copysign(abs(x) ** power, x)


@compiled
def surface_pull(
    transformed: float, alpha_1: float, alpha_2: float, phi_1: float, phi_2: float, eta: float
) -> float:
    """Return ψ(ε) = α₁ sig(ε)^φ₁ + α₂ χ(ε).

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
    """Return ψ′(ε)."""
    size = abs(transformed)
    if size >= eta:
        d_chi = phi_2 * size ** (phi_2 - 1.0)
    else:
        linear = (2.0 - phi_2) * eta ** (phi_2 - 1.0)
        quadratic = (phi_2 - 1.0) * eta ** (phi_2 - 2.0)
        d_chi = linear + 2.0 * quadratic * size
    slope: float = alpha_1 * phi_1 * size ** (phi_1 - 1.0) + alpha_2 * d_chi
    return slope

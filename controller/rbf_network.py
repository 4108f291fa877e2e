"""The radial basis function network that stands in for the arm's unknown dynamics.

After section 4 of the paper: inputs are the *transformed* errors, so they stay in a known range
however large the errors are, and the adaptation itself converges in fixed time. Placement and
width of the nodes are ours: each joint has its own grid over its own two inputs, so that the
network neither grows with the square of the joints nor depends on their order.
"""

from __future__ import annotations

import math

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.compiled import compiled

NODES_PER_AXIS = 5
NODES = NODES_PER_AXIS**2


def node_centres() -> Vector:
    """Centres over [-1, 1]², shape (nodes, 2)."""
    axis = np.linspace(-1.0, 1.0, NODES_PER_AXIS)
    return np.array([(x, y) for x in axis for y in axis])


@compiled
def activate(inputs_1: float, inputs_2: float, centres: Vector, width: float, out: Vector) -> None:
    """Φ_k(z) = exp(−|z − c_k|² / (2 width²)) into `out`, shape (nodes,)."""
    for k in range(centres.shape[0]):
        d_1, d_2 = inputs_1 - centres[k, 0], inputs_2 - centres[k, 1]
        out[k] = math.exp(-(d_1 * d_1 + d_2 * d_2) / (2.0 * width * width))


@compiled
def adapt(
    weights: Vector, activation: Vector, s: float, step_s: float,
    rate: float, kappa_1: float, kappa_2: float, gamma_1: float, gamma_2: float,
) -> None:  # fmt: skip
    """One explicit step of dŴ/dt = Γ (Φ s − κ₁ sig(Ŵ)^γ₁ − κ₂ sig(Ŵ)^γ₂), in place."""
    for k in range(weights.shape[0]):
        w = weights[k]
        leakage = 0.0
        if w != 0.0:  # both powers from one logarithm
            log_w = math.log(abs(w))
            powers = kappa_1 * math.exp(gamma_1 * log_w) + kappa_2 * math.exp(gamma_2 * log_w)
            leakage = math.copysign(powers, w)
        weights[k] = w + step_s * rate * (activation[k] * s - leakage)

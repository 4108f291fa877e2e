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
from bus_schema.runtime.compiled import compiled

NODES_PER_AXIS = 5
NODES = NODES_PER_AXIS**2


NODE_AXIS = np.linspace(-1.0, 1.0, NODES_PER_AXIS)
"""Coordinates of the nodes along either input, shape (nodes per axis,); node k = 5 i + j."""


@compiled
def activate(inputs_1: float, inputs_2: float, width: float, out: Vector) -> None:
    """Φ_k(z) = exp(−|z − c_k|² / (2 width²)) into `out`, shape (nodes,).

    On a grid the Gaussian is a product of one factor per input, which saves most exponentials.
    """
    axis, size = NODE_AXIS, NODE_AXIS.size
    steepness = -1.0 / (2.0 * width * width)
    for j in range(size):
        out[j] = math.exp(steepness * (inputs_2 - axis[j]) ** 2)
    for i in range(size - 1, -1, -1):  # the first row holds the second factors until its own turn
        factor = math.exp(steepness * (inputs_1 - axis[i]) ** 2)
        for j in range(size):
            out[i * size + j] = factor * out[j]


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

"""Bounds on the settling time of fixed-time laws for any initial error.

After the paper's first theorem, with the constants worked out here. V = ½ sᵀ M s falls as
V̇ ≤ −a V^((γ₁+1)/2) − b V^((γ₂+1)/2), so s reaches zero within the reaching bound; from there on
ε̇ = −ψ(ε) takes the error to |ε| ≤ η within the sliding bound.

Assumptions: torques within their limits, no delay, and reaching terms that dominate the disturbance
(or, for the neural law, the network's error). For the model-based law on a perfect model it is a
theorem. For the neural law, whose loop is proved only *practically* fixed-time stable, it bounds
reaching and sliding once its network is good enough, but not the time that the network needs for
that.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from bus_schema.arrays import Vector, elementwise
from controller.laws.fixed_time_model_based import FixedTimeModelBasedGains
from controller.laws.fixed_time_neural import FixedTimeNeuralGains

LargestInertia = Callable[[Vector], float]
"""Function of weights w, shape (joints,): largest eigenvalue of diag(w) M(q) diag(w) over all q."""


FixedTimeGains = FixedTimeModelBasedGains | FixedTimeNeuralGains


def settling_bound_s(gains: FixedTimeGains, largest_inertia: LargestInertia) -> float:
    """Return the reaching plus sliding bound, s; infinite where a gain k_1 or k_2 is zero."""
    return reaching_bound_s(gains, largest_inertia) + sliding_bound_s(gains)


def sliding_bound_s(gains: FixedTimeGains) -> float:
    """Return T_s = 1 / (α₁ (φ₁ − 1)) + 1 / (α₂ (1 − φ₂)), s."""
    g = gains
    return 1.0 / (g.alpha_1 * (g.phi_1 - 1.0)) + 1.0 / (g.alpha_2 * (1.0 - g.phi_2))


def reaching_bound_s(gains: FixedTimeGains, largest_inertia: LargestInertia) -> float:
    """Return T_r = 2 / (a (γ₁ − 1)) + 2 / (b (1 − γ₂)), s.

    With D = diag(k₁)^(1/(γ₁+1)), Σ k₁ |s|^(γ₁+1) = Σ |D s|^(γ₁+1) ≥ n^((1−γ₁)/2) ‖D s‖^(γ₁+1), and
    V ≤ ½ λ ‖D s‖² for λ = λ_max(D⁻¹ M D⁻¹), so a = n^((1−γ₁)/2) (2 / λ)^((γ₁+1)/2); b likewise,
    without the factor in n, as γ₂ < 1. For equal gains this is the textbook form with k₁ and
    λ_max(M); for unequal ones it is tighter than with the smallest gain.
    """
    g = gains
    if not (g.k_1.all() and g.k_2.all()):
        return math.inf
    joints = g.k_1.size
    spread = float(joints) ** ((1.0 - g.gamma_1) / 2.0)
    a = spread * _rate(g.k_1, g.gamma_1, largest_inertia)
    b = _rate(g.k_2, g.gamma_2, largest_inertia)
    bound: float = 2.0 / (a * (g.gamma_1 - 1.0)) + 2.0 / (b * (1.0 - g.gamma_2))
    return bound


def _rate(gain: Vector, gamma: float, largest_inertia: LargestInertia) -> float:
    weights = elementwise(lambda k: math.pow(k, -1.0 / (gamma + 1.0)), gain)
    return float((2.0 / largest_inertia(weights)) ** ((gamma + 1.0) / 2.0))

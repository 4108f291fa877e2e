"""The fixed-time adaptive law: a nominal model, and a network for the model's errors.

It has the funnel and the terminal sliding surface of the paper's laws. With the reference motion
q̇_r, q̈_r of the model-based law and the network of the neural one,

    τ = M̂ q̈_r + Ĉ q̇_r + Ĝ − Ŵᵀ Φ(z) − K₁ sig(s)^γ₁ − K₂ sig(s)^γ₂ − K₃ s.

With s = q̇ − q̇_r the arm then moves by

    M ṡ + C s = Δ − Ŵᵀ Φ(z) − K₁ sig(s)^γ₁ − K₂ sig(s)^γ₂ − K₃ s,
    Δ = (M̂ − M) q̈_r + (Ĉ − C) q̇_r + Ĝ − G − friction − disturbance,

which is the equation of the paper's second theorem with the model error Δ instead of the arm's
whole dynamics. So its proof applies unchanged: V = ½ sᵀ M s + ½ Σ W̃ᵀ Γ⁻¹ W̃ is practically
fixed-time stable, with a network that has less to learn. With an exact model and no disturbance, Δ
= 0, and the first theorem's bound on the settling time holds too.
"""

from __future__ import annotations

import numpy as np

from bus_schema.arrays import Vector
from controller.control_law import Dynamics, Tracking
from controller.laws.fixed_time_model_based import FixedTimeModelBased, FixedTimeModelBasedGains
from controller.laws.fixed_time_neural import FixedTimeNeural, FixedTimeNeuralGains


class FixedTimeAdaptiveGains(FixedTimeNeuralGains):
    """Gains of the network and of reaching, as for the neural law."""

    @classmethod
    def from_inertia(cls, inertia_kg_m2: Vector) -> FixedTimeAdaptiveGains:
        """Return gains for joints with these inertias, shape (joints,).

        The network learns the model's errors twice as fast. That compensates for a tenth of K₂,
        whose power below 1 is so steep at s = 0 that in discrete time the torque chatters.
        """
        own = cls(*FixedTimeNeuralGains.from_inertia(inertia_kg_m2))
        return own._replace(
            k_2=0.1 * own.k_2, adaptation_rate=2.0 * own.adaptation_rate, delayed_k_2=0.0
        )


class FixedTimeAdaptive:
    """The law: the sum of the neural law's torque and the model's."""

    def __init__(
        self, gains: FixedTimeAdaptiveGains, model: Dynamics, torque_limits_nm: Vector
    ) -> None:
        self._neural = FixedTimeNeural(gains, model, torque_limits_nm)
        self.diagnostics = self._neural.diagnostics
        none = np.zeros_like(gains.k_1)
        shared = {
            name: getattr(gains, name)
            for name in FixedTimeModelBasedGains._fields
            if not name.startswith("k_")
        }
        # With zero gains, the model-based law returns only its model's torque.
        feedforward = FixedTimeModelBasedGains(k_1=none, k_2=none, k_3=none, **shared)
        self._model_based = FixedTimeModelBased(feedforward, model, torque_limits_nm)

    def reset(self) -> None:
        self._neural.reset()
        self._model_based.reset()

    def torque(self, tracking: Tracking) -> Vector:
        # In place: the network stops learning while the sum is beyond a limit.
        torque = self._neural.torque(tracking)
        torque += self._model_based.torque(tracking)
        return torque

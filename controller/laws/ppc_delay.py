"""Prescribed performance whose envelope widens with the torques that do not act yet.

    ξ₁ = e / (ψ + ζ₁),    ξ₂ = (ė + λ (ψ + ζ₁) T(ξ₁)) / (λ σ ψ + ζ₂),    τ = −K T(ξ₂),
    ζ̇₂ = |τ(t) − τ(t − d)| / M̄ − μ ζ₂,    ζ̇₁ = ζ₂ − μ ζ₁,    T(ξ) = ½ ln((1 + ξ) / (1 − ξ))

After the idea of Berger, Bikas, Hachmeister and Rovithakis, Prescribed performance control of
uncertain higher relative degree nonlinear systems in the presence of delays (arXiv 2509.08601):
with measurement and input delayed, a correction widens the prescribed envelope by what is in
flight, and without delay the envelope is the prescribed one. Their text gives the problem and the
properties here; the equations above are ours. ζ₂ is the velocity, and ζ₁ the position, that the
torques in flight may still change, forgotten with μ. ψ is the bound on the side of the error, d the
round trip that the law is designed for (0 for none), and λ and σ as in `funnel_control`. No model,
and no notion of the delay that really is. Beyond 98 % of an envelope, T continues as a line.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.configuration import NonNegative, PerJointPositive, Positive
from bus_schema.runtime.compiled import compiled
from controller.control_law import LOWER, UPPER, Diagnostics, Dynamics, Tracking
from controller.laws.sliding_mode import default_stiffness

_LARGEST = 0.98
_SAME_S = 1e-6
"""Tolerance of times: rounding does not decide which torque is the delayed one."""
_REMEMBERED = 2048
"""Torques remembered: 0.5 s at 4 kHz; of a longer time, the oldest."""


class PpcDelayGains(NamedTuple):
    """Torque K, N m, rate λ, 1/s, and inertia M̄, kg m², per joint; opening σ, d and μ.

    Attributes:
        delay_ms: round trip d that the envelope is widened for; 0 for none.
        forgetting: rate μ at which the widening is forgotten, 1/s.
    """

    torque_nm: PerJointPositive
    rate: PerJointPositive
    inertia_kg_m2: PerJointPositive
    opening: Positive = 2.0
    delay_ms: NonNegative = 10.0
    forgetting: Positive = 40.0

    @classmethod
    def from_inertia(cls, inertia_kg_m2: Vector) -> PpcDelayGains:
        """Return gains for which a funnel of 10 mrad is stiff, and damped."""
        torque_nm = 0.08 * default_stiffness(inertia_kg_m2) * inertia_kg_m2
        return cls(torque_nm, 30.0 * np.ones_like(inertia_kg_m2), inertia_kg_m2)


class _Memory(NamedTuple):
    """The law's state: a ring of torques, N m, with their times, s; and the corrections.

    Attributes:
        torques: shape (remembered, joints).
        times_s: shape (remembered,).
        counts: torques written, and of these those older than the delay; shape (2,).
        widening: ζ₁, rad, and ζ₂, rad/s, as rows, shape (2, joints).
    """

    torques: Matrix
    times_s: Vector
    counts: NDArray[np.int64]
    widening: Matrix


class PpcDelay:
    """The law. It remembers torques within their limits, as only these can act."""

    def __init__(self, gains: PpcDelayGains, _model: Dynamics, torque_limits_nm: Vector) -> None:
        joints = gains.rate.size
        self.diagnostics = Diagnostics(joints)
        self._gains, self._limits = gains, torque_limits_nm
        self._torque: Vector = np.zeros(joints)
        self._memory = _Memory(
            np.zeros((_REMEMBERED, joints)), np.zeros(_REMEMBERED), np.zeros(2, np.int64),
            np.zeros((2, joints)),
        )  # fmt: skip

    def reset(self) -> None:
        for values in self._memory:
            values[:] = 0

    def torque(self, tracking: Tracking) -> Vector:
        _torque(
            tracking.error, tracking.error_rate, tracking.bounds, tracking.step_s, tracking.time_s,
            self._gains, self._limits, self._memory, self._torque,
        )  # fmt: skip
        return self._torque


@compiled
def _torque(
    error: Vector, error_rate: Vector, bounds: Matrix, step_s: float, time_s: float,
    gains: PpcDelayGains, limits: Vector, memory: _Memory, torque: Vector,
) -> None:  # fmt: skip
    g, newest = gains, memory.counts[0]
    delayed = _older_than(memory, time_s - 1e-3 * g.delay_ms)
    slot = newest % _REMEMBERED
    memory.times_s[slot] = time_s
    left = math.exp(-g.forgetting * step_s)
    for i in range(error.size):
        if newest > 0 and g.delay_ms > 0.0:
            acted = memory.torques[delayed % _REMEMBERED, i] if delayed >= 0 else 0.0
            in_flight = abs(memory.torques[(newest - 1) % _REMEMBERED, i] - acted)
            memory.widening[1, i] += step_s * in_flight / g.inertia_kg_m2[i]
            memory.widening[0, i] += step_s * memory.widening[1, i]
            memory.widening[0, i] *= left
            memory.widening[1, i] *= left
        bound = bounds[UPPER, i] if error[i] >= 0.0 else bounds[LOWER, i]
        wide = bound + memory.widening[0, i]
        pulled = error_rate[i] + g.rate[i] * wide * _transformed(error[i] / wide)
        envelope = g.rate[i] * g.opening * bound + memory.widening[1, i]
        torque[i] = -g.torque_nm[i] * _transformed(pulled / envelope)
        memory.torques[slot, i] = min(max(torque[i], -limits[i]), limits[i])
    memory.counts[0] = newest + 1


@compiled
def _older_than(memory: _Memory, time_s: float) -> int:
    """Return the number of the newest torque from before a time; of those remembered, the oldest.

    -1 for none, while all since the start are remembered.
    """
    written = memory.counts[0]
    following = max(memory.counts[1], written - _REMEMBERED)
    while following < written and memory.times_s[following % _REMEMBERED] <= time_s + _SAME_S:
        following += 1
    memory.counts[1] = following
    return max(following - 1, written - _REMEMBERED, -1)  # type: ignore[no-any-return]


@compiled
def _transformed(share: float) -> float:
    """Return ½ ln((1 + ξ) / (1 − ξ)), which continues as a line beyond the largest share."""
    inside = min(max(share, -_LARGEST), _LARGEST)
    slope = 1.0 / (1.0 - _LARGEST * _LARGEST)
    return 0.5 * math.log((1.0 + inside) / (1.0 - inside)) + slope * (share - inside)

"""The fixed-time neural law: model-free, with a funnel, a terminal sliding surface and a network.

After section 4 of the paper (the proposed law). With s the sliding variable divided by the slope
r of the error transformation, so that s = q̇ − q̇_r for a reference velocity q̇_r,

    τ = −Ŵᵀ Φ(z) − K₁ sig(s)^γ₁ − K₂ sig(s)^γ₂ − K₃ s,
    dŴ/dt = Γ (Φ(z) s − κ₁ sig(Ŵ)^γ₁ − κ₂ sig(Ŵ)^γ₂),   z = (tanh ε, tanh 0.1 ε̇).

A network of radial basis functions, Φ, replaces the arm's unknown dynamics. Its inputs z are the
*transformed* errors, so they stay in a known range for errors of any size, and the adaptation
itself converges in fixed time. Placement and width of the nodes are ours: each joint has its own
grid over its own two inputs, so that the network neither grows with the square of the joints nor
depends on their order.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.configuration import (
    NonNegative,
    PerJointNonNegative,
    PerJointPositive,
    Positive,
    PowerAboveOne,
    PowerBelowOne,
)
from bus_schema.runtime.compiled import bind, compiled
from controller.control_law import (
    NETWORK_OUTPUT,
    SLIDING_VARIABLE,
    TRANSFORMED_ERROR,
    Diagnostics,
    Dynamics,
    Tracking,
    may_accumulate,
)
from controller.funnel import transform, transformation_rates
from controller.laws.reopening import working_bounds
from controller.laws.sliding_surface import sig, surface_pull

NODES_PER_AXIS = 5
NODES = NODES_PER_AXIS**2


NODE_AXIS = np.linspace(-1.0, 1.0, NODES_PER_AXIS)
"""Coordinates of the nodes along either input, shape (nodes per axis,); node k = 5 i + j."""


@compiled
def activate(inputs_1: float, inputs_2: float, width: float, out: Vector) -> None:
    """Write Φ_k(z) = exp(−|z − c_k|² / (2 width²)) into `out`, shape (nodes,).

    On a grid the Gaussian is a product of one factor per input, which saves most exponentials.
    """
    axis, size = NODE_AXIS, NODE_AXIS.size
    steepness = -1.0 / (2.0 * width * width)
    for j in range(size):
        out[j] = math.exp(steepness * (inputs_2 - axis[j]) ** 2)
    for i in range(size - 1, -1, -1):  # the first row comes last: it holds the second factors
        factor = math.exp(steepness * (inputs_1 - axis[i]) ** 2)
        for j in range(size):
            out[i * size + j] = factor * out[j]


@compiled
def adapt(
    weights: Vector, activation: Vector, s: float, step_s: float,
    rate: float, kappa_1: float, kappa_2: float, gamma_1: float, gamma_2: float,
) -> None:  # fmt: skip
    """Take one explicit step of dŴ/dt = Γ (Φ s − κ₁ sig(Ŵ)^γ₁ − κ₂ sig(Ŵ)^γ₂), in place."""
    for k in range(weights.shape[0]):
        w = weights[k]
        leakage = 0.0
        if w != 0.0:  # both powers from one logarithm
            log_w = math.log(abs(w))
            powers = kappa_1 * math.exp(gamma_1 * log_w) + kappa_2 * math.exp(gamma_2 * log_w)
            leakage = math.copysign(powers, w)
        weights[k] = w + step_s * rate * (activation[k] * s - leakage)


class FixedTimeNeuralGains(NamedTuple):
    """Gains, with the symbols of the equations; K₁, K₂, K₃ and Γ per joint.

    With a compensated delay, a network with narrow nodes and fast adaptation is too stiff:
    prediction errors cause a limit cycle. So gains depend on the horizon h, and go the share (h /
    h_½)⁴ / (1 + (h / h_½)⁴) of the way to

        delayed_node_width: the width of the nodes,
        delayed_adaptation: a factor on the adaptation rate,
        delayed_k_2: a factor on k_2, whose power below 1 is infinitely steep at s = 0,

    and half_way_s = h_½. Without delay the gains are used as given.
    """

    k_1: PerJointNonNegative
    k_2: PerJointNonNegative
    k_3: PerJointNonNegative
    adaptation_rate: PerJointPositive
    alpha_1: Positive = 5.0
    alpha_2: Positive = 5.0
    phi_1: PowerAboveOne = 1.4
    phi_2: PowerBelowOne = 0.6
    gamma_1: PowerAboveOne = 1.4
    gamma_2: PowerBelowOne = 0.6
    eta: Positive = 0.02
    kappa_1: NonNegative = 1e-6
    kappa_2: NonNegative = 1e-6
    node_width: Positive = 0.25
    delayed_node_width: Positive = 1.5
    delayed_adaptation: Positive = 1.0
    delayed_k_2: NonNegative = 1.0
    half_way_s: Positive = 0.008

    @classmethod
    def from_inertia(cls, inertia_kg_m2: Vector) -> FixedTimeNeuralGains:
        """Return gains for joints with these inertias, shape (joints,).

        The nodes are wide: with large gravity and small inertia, narrow nodes would make the
        network's output so steep in the error rate that the loop rings.
        """
        return cls(
            k_1=80.0 * inertia_kg_m2,
            k_2=80.0 * inertia_kg_m2,
            k_3=300.0 * inertia_kg_m2,
            adaptation_rate=500.0 * inertia_kg_m2,
            node_width=1.5,
        )


class _Memory(NamedTuple):
    """The law's state between cycles; its kernel changes it in place.

    Attributes:
        torque: N m, shape (joints,).
        opening: of the funnel, see `working_bounds`; rad, shape (joints,).
        weights: Ŵ, shape (joints, nodes).
        activation: Φ(z) of the current joint, shape (nodes,).
    """

    torque: Vector
    opening: Vector
    weights: Matrix
    activation: Vector


class FixedTimeNeural:
    """The law with its network weights."""

    def __init__(
        self, gains: FixedTimeNeuralGains, _model: Dynamics, torque_limits_nm: Vector
    ) -> None:
        joints = gains.k_1.size
        self.diagnostics = Diagnostics(joints)
        self._gains = _packed(gains)
        self._torque_limits_nm = torque_limits_nm
        self._memory = _packed(
            _Memory(np.zeros(joints), np.zeros(joints), np.zeros((joints, NODES)), np.zeros(NODES))
        )
        self._torque: Vector = self._memory["torque"][0]
        self._tracking: Tracking | None = None

    def reset(self) -> None:
        self._memory[:] = np.zeros((), self._memory.dtype)

    def torque(self, tracking: Tracking) -> Vector:
        if tracking is not self._tracking:
            self._bind(tracking)
        self._kernel(tracking.step_s, tracking.horizon_s)
        return self._torque

    def _bind(self, tracking: Tracking) -> None:
        """Bind the kernel's arguments: determining their types costs more than the law itself."""
        self._tracking, inner = tracking, self.diagnostics
        self._kernel = bind(
            _torque,
            tracking.error, tracking.error_rate, tracking.bounds,
            self._gains, self._torque_limits_nm, self._memory,
            inner.published, inner.network_norm,
            free=["float64", "float64"],
        )  # fmt: skip


def _packed(several: FixedTimeNeuralGains | _Memory) -> NDArray[np.void]:
    """Return a tuple of numbers and arrays as a structured array of one element, same field names.

    Tuples would be unpacked at every call, which takes a tenth of a control step.
    """
    values = several._asdict()
    dtype = np.dtype([(name, np.float64, np.shape(value)) for name, value in values.items()])
    return np.array([tuple(values.values())], dtype)


@compiled
def _delayed(g: Any, horizon_s: float) -> tuple[float, float, float]:
    """Return node width, and factors on adaptation rate and k_2, at a horizon."""
    share = 1.0 / (1.0 + (g.half_way_s / horizon_s) ** 4)  # none at 0, for any half_way_s
    width = g.node_width * (g.delayed_node_width / g.node_width) ** share
    return width, g.delayed_adaptation**share, 1.0 + share * (g.delayed_k_2 - 1.0)


@compiled
def _torque(
    error: Vector, error_rate: Vector, bounds: Matrix,
    gains: NDArray[np.void], torque_limits: Vector, memory: NDArray[np.void],
    published: Matrix, network_norm: Vector,
    step_s: float, horizon_s: float,
) -> None:  # fmt: skip
    g, m = gains[0], memory[0]
    torque, opening, weights, activation = m.torque, m.opening, m.weights, m.activation
    width, slower, k_2_factor = _delayed(g, horizon_s)
    squared_norm = 0.0
    for i in range(error.size):
        upper, lower, opening[i] = working_bounds(error[i], bounds[:, i], step_s, opening[i])
        r, v = transformation_rates(error[i], upper, lower)
        epsilon = transform(error[i], upper, lower)
        d_epsilon = r * (error_rate[i] - v)
        pull = surface_pull(epsilon, g.alpha_1, g.alpha_2, g.phi_1, g.phi_2, g.eta)
        s = (d_epsilon + pull) / r

        activate(math.tanh(epsilon), math.tanh(0.1 * d_epsilon), width, activation)
        if may_accumulate(torque[i], s, torque_limits[i]):
            adapt(
                weights[i], activation, s, step_s,
                slower * g.adaptation_rate[i], g.kappa_1, g.kappa_2, g.gamma_1, g.gamma_2,
            )  # fmt: skip
        output = 0.0
        for k in range(activation.size):
            output -= weights[i, k] * activation[k]
            squared_norm += weights[i, k] * weights[i, k]

        reaching = g.k_1[i] * sig(s, g.gamma_1) + g.k_3[i] * s
        reaching += k_2_factor * g.k_2[i] * sig(s, g.gamma_2)
        torque[i] = output - reaching
        published[TRANSFORMED_ERROR, i] = epsilon
        published[SLIDING_VARIABLE, i] = s
        published[NETWORK_OUTPUT, i] = output
    network_norm[0] = math.sqrt(squared_norm)

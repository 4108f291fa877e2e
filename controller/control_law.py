"""What a control law is: from the tracking errors of a moment to joint torques."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.runtime.compiled import bind, compiled
from controller.funnel import Funnel, performance_function
from controller.reference import Reference

UPPER, D_UPPER, DD_UPPER, LOWER, D_LOWER, DD_LOWER = 0, 1, 2, 3, 4, 5
"""Rows of `Tracking.bounds`."""


class Tracking:
    """The situation a law has to answer.

    Arrays have shape (joints,) and are reused every cycle. They can be replaced before the first
    `update`; from then on compiled code keeps hold of them.

    Attributes:
        time_s: time of measurement since the start of the run.
        step_s: time since the previous measurement; 0 at the first.
        position: rad; velocity: rad/s; as measured.
        reference_position: rad; reference_velocity: rad/s; reference_acceleration: rad/s².
        error: position minus reference, rad; error_rate: its rate, rad/s.
        bounds: shape (6, joints): the funnel −lower < error < upper with first and second
            derivatives, rows `UPPER` to `DD_LOWER`.
        upper_bound: rad; lower_bound: rad; the ends of the funnel, the lower one negative.
    """

    def __init__(self, joints: int) -> None:
        self.time_s = 0.0
        self.step_s = 0.0
        self.position: Vector = np.zeros(joints)
        self.velocity: Vector = np.zeros(joints)
        self.reference_position: Vector = np.zeros(joints)
        self.reference_velocity: Vector = np.zeros(joints)
        self.reference_acceleration: Vector = np.zeros(joints)
        self.error: Vector = np.zeros(joints)
        self.error_rate: Vector = np.zeros(joints)
        self.bounds: Matrix = np.zeros((6, joints))
        self.upper_bound: Vector = np.zeros(joints)
        self.lower_bound: Vector = np.zeros(joints)
        self._reference: Reference | None = None
        self._funnel: Funnel | None = None

    def update(self, time_s: float, step_s: float, reference: Reference, funnel: Funnel) -> None:
        """Take stock at `time_s`, with `position` and `velocity` already set."""
        if funnel is not self._funnel or reference is not self._reference:
            self._bind(reference, funnel)
        self.time_s, self.step_s = time_s, step_s
        self._follow(time_s)
        self._take_stock(time_s)

    def _bind(self, reference: Reference, funnel: Funnel) -> None:
        self._reference, self._funnel = reference, funnel
        self._follow = reference.onto(
            self.reference_position, self.reference_velocity, self.reference_acceleration
        )
        self._take_stock = bind(
            _errors_and_bounds,
            self.position,
            self.velocity,
            self.reference_position,
            self.reference_velocity,
            np.array([funnel.initial_upper_rad, funnel.initial_lower_rad, funnel.final_rad]),
            float(funnel.rate_per_s),
            self.error,
            self.error_rate,
            self.bounds,
            self.upper_bound,
            self.lower_bound,
            free=["float64"],
        )


@compiled
def _errors_and_bounds(
    position: Vector, velocity: Vector,
    reference_position: Vector, reference_velocity: Vector,
    funnel: Matrix, rate: float,
    error: Vector, error_rate: Vector, bounds: Matrix,
    upper_bound: Vector, lower_bound: Vector, time_s: float,
) -> None:  # fmt: skip
    for i in range(position.size):
        error[i] = position[i] - reference_position[i]
        error_rate[i] = velocity[i] - reference_velocity[i]
        bounds[UPPER, i], bounds[D_UPPER, i], bounds[DD_UPPER, i] = performance_function(
            time_s, funnel[0, i], funnel[2, i], rate
        )
        bounds[LOWER, i], bounds[D_LOWER, i], bounds[DD_LOWER, i] = performance_function(
            time_s, funnel[1, i], funnel[2, i], rate
        )
        upper_bound[i], lower_bound[i] = bounds[UPPER, i], -bounds[LOWER, i]


class Diagnostics:
    """What a law lets out about its inner state, shape (joints,) each; NaN for what it has not."""

    def __init__(self, joints: int) -> None:
        self.transformed_error: Vector = np.full(joints, np.nan)
        self.sliding_variable: Vector = np.full(joints, np.nan)
        self.network_output: Vector = np.full(joints, np.nan)
        self.network_norm: Vector = np.full(1, np.nan)


class Dynamics(Protocol):
    """What a model-based law may ask of a nominal model M(q) q̈ + C(q, q̇) q̇ + G(q) = τ.

    All vectors have shape (joints,); `ManipulatorModel` says more.
    """

    joints: int

    def inverse_dynamics(self, position: Vector, velocity: Vector, acceleration: Vector) -> Vector:
        """M(q) a + C(q, q̇) q̇ + G(q), N m, in a fresh array."""
        ...

    def torque_along(
        self, position: Vector, velocity: Vector, along_velocity: Vector, acceleration: Vector
    ) -> Vector:
        """M(q) a + C(q, q̇) v + G(q) for a velocity v that need not be q̇, N m, in a fresh array."""
        ...


class ControlLaw(Protocol):
    """A control law; all of its memory is its own, and all of its time comes from `Tracking`.

    The same sequence of inputs after construction or `reset` gives the same bits.
    """

    diagnostics: Diagnostics

    def torque(self, tracking: Tracking) -> Vector:
        """Joint torques in N m, shape (joints,); the array may be reused by the next call."""
        ...

    def reset(self) -> None:
        """Forget everything since construction."""
        ...

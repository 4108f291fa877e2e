"""Interface of control laws: from the current tracking errors to joint torques."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.runtime.compiled import bind, compiled
from controller.funnel import Funnel, performance_function
from controller.reference import Reference

UPPER, D_UPPER, DD_UPPER, LOWER, D_LOWER, DD_LOWER = 0, 1, 2, 3, 4, 5
"""Rows of `Tracking.bounds`."""
ABSENCE_STATES = 16
"""An absence of states is longer than this many of their periods.

A law does not integrate over it, as it did not see how the error grew. With all of 500 ms in one
step, the network of the adaptive law asked for 35 times the torque of a motor.
"""


class Tracking:
    """The situation that a law answers.

    Arrays have shape (joints,) unless stated, are reused every cycle and never replaced: compiled
    code keeps references to them. The caller writes `position` and `velocity`; `update` writes all
    others.

    Args:
        joints: number of joints.
        motion: array for positions and velocities, shape (2, joints).
        published: array for the values of a control status, rows named by `PUBLISHED`. Both may be
            part of messages, which saves the control loop two copies per cycle.

    Attributes:
        time_s: time of measurement since the start of the run.
        step_s: time since the previous measurement that the law received; 0 at the first.
        horizon_s: time from the measurement to this situation; 0 unless predicted.
        position: rad; velocity: rad/s; as measured.
        motion: both as rows, shape (2, joints).
        reference_position: rad; reference_velocity: rad/s; reference_acceleration: rad/s².
        error: position minus reference, rad; error_rate: its rate, rad/s.
        bounds: shape (6, joints): the funnel −lower < error < upper with first and second
            derivatives, rows `UPPER` to `DD_LOWER`.
        upper_bound: rad; lower_bound: rad; the ends of the funnel, the lower one negative.
    """

    PUBLISHED = (
        "reference_position", "reference_velocity", "error", "error_rate",
        "upper_bound", "lower_bound",
    )  # fmt: skip

    def __init__(
        self, joints: int, motion: Matrix | None = None, published: Matrix | None = None
    ) -> None:
        self.time_s = 0.0
        self.step_s = 0.0
        self.horizon_s = 0.0
        self.motion: Matrix = _as_in_a_message(2, joints) if motion is None else motion
        self.position: Vector
        self.velocity: Vector
        self.position, self.velocity = self.motion
        rows = _as_in_a_message(len(self.PUBLISHED), joints) if published is None else published
        self._published: Matrix = rows
        self.reference_position: Vector = rows[_POSITION]
        self.reference_velocity: Vector = rows[_VELOCITY]
        self.reference_acceleration: Vector = np.zeros(joints)
        self.error: Vector = rows[_ERROR]
        self.error_rate: Vector = rows[_ERROR_RATE]
        self.upper_bound: Vector = rows[_UPPER]
        self.lower_bound: Vector = rows[_LOWER]
        self.bounds: Matrix = np.zeros((6, joints))
        self._reference: Reference | None = None
        self._funnel: Funnel | None = None

    def update(self, time_s: float, step_s: float, reference: Reference, funnel: Funnel) -> None:
        """Compute errors and bounds at `time_s`."""
        if funnel is not self._funnel or reference is not self._reference:
            self._bind(reference, funnel)
        self.time_s, self.step_s = time_s, step_s
        self._follow(time_s)
        self._compare(time_s)

    def reference_at(self, times_s: Vector) -> Matrix:
        """Return positions and velocities of the reference at times, shape (times, 2, joints)."""
        assert self._reference is not None  # `update` comes first
        rows = np.empty((len(times_s), 3, self.error.size))
        for row, time_s in zip(rows, times_s.tolist(), strict=True):
            self._reference.evaluate(time_s, *row)
        return rows[:, :2].copy()

    def _bind(self, reference: Reference, funnel: Funnel) -> None:
        self._reference, self._funnel = reference, funnel
        self._follow = reference.onto(
            self.reference_position, self.reference_velocity, self.reference_acceleration
        )
        ends = np.array([funnel.initial_upper_rad, funnel.initial_lower_rad, funnel.final_rad])
        self._compare = bind(
            _errors_and_bounds, self.motion, self._published, self.bounds, ends,
            float(funnel.rate_per_s), free=["float64"],
        )  # fmt: skip


_POSITION, _VELOCITY, _ERROR, _ERROR_RATE, _UPPER, _LOWER = range(6)
"""Rows of a `Tracking`'s published values, in the order of its `PUBLISHED`."""


def _as_in_a_message(rows: int, joints: int) -> Matrix:
    """Return zeros whose rows are apart, as in a message: the same compiled code takes both."""
    return np.zeros((rows, joints + 1))[:, :joints]


@compiled
def _errors_and_bounds(
    motion: Matrix, published: Matrix, bounds: Matrix, funnel: Matrix, rate_per_s: float,
    time_s: float,
) -> None:  # fmt: skip
    initial_upper, initial_lower, final = funnel[0], funnel[1], funnel[2]
    for i in range(motion.shape[1]):
        published[_ERROR, i] = motion[0, i] - published[_POSITION, i]
        published[_ERROR_RATE, i] = motion[1, i] - published[_VELOCITY, i]
        bounds[UPPER, i], bounds[D_UPPER, i], bounds[DD_UPPER, i] = performance_function(
            time_s, initial_upper[i], final[i], rate_per_s
        )
        bounds[LOWER, i], bounds[D_LOWER, i], bounds[DD_LOWER, i] = performance_function(
            time_s, initial_lower[i], final[i], rate_per_s
        )
        published[_UPPER, i], published[_LOWER, i] = bounds[UPPER, i], -bounds[LOWER, i]


class Diagnostics:
    """A law's report of its internal state, shape (joints,) each; NaN for missing values.

    Assigning to one of these arrays copies the values into it, as others keep references to it.

    Attributes:
        transformed_error: ε; sliding_variable: s, rad/s; network_output: N m.
        network_norm: norm of the network's weights, shape (1,).
        published: the first three as rows, named by `PUBLISHED`, for the control status.
    """

    PUBLISHED = ("transformed_error", "sliding_variable", "network_output")
    transformed_error: Vector
    sliding_variable: Vector
    network_output: Vector
    network_norm: Vector

    def __init__(self, joints: int) -> None:
        self.published: Matrix = np.full((len(self.PUBLISHED), joints), np.nan)
        self.transformed_error, self.sliding_variable, self.network_output = self.published
        self.network_norm = np.full(1, np.nan)

    def __setattr__(self, name: str, values: object) -> None:
        if name in Diagnostics.__annotations__ and name in vars(self):
            getattr(self, name)[...] = values
        else:
            super().__setattr__(name, values)


TRANSFORMED_ERROR, SLIDING_VARIABLE, NETWORK_OUTPUT = range(3)
"""Rows of the published `Diagnostics`, in the order of its `PUBLISHED`."""


class Dynamics(Protocol):
    """Methods of a nominal model M(q) q̈ + C(q, q̇) q̇ + G(q) = τ for a model-based law.

    All vectors have shape (joints,); see `ManipulatorModel`.
    """

    joints: int

    def inverse_dynamics(self, position: Vector, velocity: Vector, acceleration: Vector) -> Vector:
        """Return M(q) a + C(q, q̇) q̇ + G(q), N m, in a new array."""

    def torque_along(
        self, position: Vector, velocity: Vector, along_velocity: Vector, acceleration: Vector
    ) -> Vector:
        """Return M(q) a + C(q, q̇) v + G(q), N m, in a new array; v may differ from q̇."""

    def inertial_parameters(self) -> Vector:
        """Return the parameters of the links, dimensionless, shape (parameters,)."""

    def regressor(
        self, position: Vector, velocity: Vector, along_velocity: Vector, acceleration: Vector
    ) -> Matrix:
        """Return Y, N m per parameter, shape (joints, parameters), without rotors."""


class AroundLaw:
    """A law around another one, `_law`, whose diagnostics it has."""

    _law: Any
    _diagnostics: Diagnostics
    """In place of those of a law without any; NaN."""

    @property
    def diagnostics(self) -> Diagnostics:
        """Those of the law, which may be new after a reset."""
        own: Diagnostics | None = getattr(self._law, "diagnostics", None)
        return self._diagnostics if own is None else own


class ControlLaw(Protocol):
    """A control law; its state is private, and its time comes only from `Tracking`.

    The same sequence of inputs after construction or `reset` gives the same bits. A law that holds
    a resource, such as a process, also has a method `close`.
    """

    @property
    def diagnostics(self) -> Diagnostics:
        """Its internal state; a law may have new ones after a reset."""

    def torque(self, tracking: Tracking) -> Vector:
        """Return joint torques in N m, shape (joints,); the next call may reuse the array."""

    def reset(self) -> None:
        """Forget everything since construction."""


@compiled
def may_accumulate(torque_nm: float, signal: float, limit_nm: float) -> bool:
    """Whether a law's memory of a joint may integrate a signal, given the torque it requested.

    Conditional integration, after Åström and Hägglund, PID Controllers (1995), section 3.5. A
    memory (an integral of the error, a network driven by the sliding variable) pushes the torque
    against its signal. While the last requested torque exceeds the joint's limit, a push further
    out would change only the memory, which must be unlearned later: it is skipped. A push back
    inwards is always integrated.
    """
    return abs(torque_nm) <= limit_nm or torque_nm * signal > 0.0

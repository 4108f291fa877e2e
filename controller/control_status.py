"""Status published every cycle: the law's internal state, and the loop's timing."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Records, Vector
from bus_schema.messages.record import Record
from bus_schema.runtime.compiled import assign, bind, compiled, copying
from controller.compensation.arm_belief import ArmBelief
from controller.compensation.delay_compensation import DelayCompensation
from controller.compensation.model_identification import INERTIA, LAG, PAYLOAD
from controller.control_law import ControlLaw, Diagnostics

_LEARNED = (
    "foreseen_error", "learned_disturbance", "learned_friction", "learned_viscous",
    "inertia_factor", "payload_kg", "actuator_lag_s",
)  # fmt: skip
"""NaN until written; some fields are never written."""


class ControlStatus:
    """Encoder of control status messages.

    Args:
        record: the message; another owner writes what `Tracking` publishes.
        law: the law, for its diagnostics.
        compensation: the delay compensation, if there is one.

    Attributes:
        cycle_started_ns: start of the newest cycle; 0 before the first.
    """

    def __init__(
        self,
        record: Record,
        law: ControlLaw,
        compensation: DelayCompensation | None,
    ) -> None:
        self._record = record
        self._law = law
        self._bind(law.diagnostics)
        for name in _LEARNED:
            self._record.fields[name][:] = np.nan
        self._take_learned = None if compensation is None else self._learned_by(compensation)
        self.cycle_started_ns = 0

    def encode(self, state: Record, cycle: int, sequence: int, started_ns: int) -> bytes:
        """Return the message of a cycle.

        Args:
            state: the answered state, whose stamp the message has.
            cycle: number of the cycle.
            sequence: number of the command.
            started_ns: start of the cycle, by ``time.perf_counter_ns``.
        """
        self._record.stamp[:] = state.stamp
        scalars = self._record.scalars
        scalars.timing_cycle = cycle
        scalars.timing_period_ns = started_ns - self.cycle_started_ns if cycle else 0
        scalars.sequence = sequence
        if self._law.diagnostics is not self._diagnostics:
            self._bind(self._law.diagnostics)
        self._take_diagnostics()
        scalars.network_norm = self._network_norm[0]
        if self._take_learned is not None:
            self._take_learned()
        self.cycle_started_ns = started_ns
        scalars.timing_step_ns = time.perf_counter_ns() - started_ns
        return self._record.payload()

    def _bind(self, diagnostics: Diagnostics) -> None:
        """Publish these diagnostics from now on; a law may have new ones after a reset."""
        # Reading from a memoryview takes half the time of NumPy's own scalars.
        self._diagnostics, self._network_norm = diagnostics, diagnostics.network_norm.data
        # One bound copy of a table takes a quarter of the time of a copy per array, in every cycle.
        self._take_diagnostics = copying(
            diagnostics.published, self._record.rows(*Diagnostics.PUBLISHED)
        )

    def _learned_by(self, compensation: DelayCompensation) -> Callable[[], None]:
        """Return a function that writes predictions and learned values in one fast bound call."""
        identification = compensation.identification
        return bind(
            _write_learned, compensation.commands.state, compensation.predicted.error,
            compensation.belief, identification.estimate,
            bool(identification.at_start[INERTIA] > 0.0),
            *(self._record.fields[name] for name in ("horizon_ns", *_LEARNED)),
        )  # fmt: skip


@compiled
def _write_learned(
    commands: Records, error: Vector, belief: ArmBelief, estimate: Vector, has_model: bool,
    horizon_ns: NDArray[np.int64], foreseen_error: Vector, disturbance: Vector, friction: Vector,
    viscous: Vector, inertia_factor: Vector, payload_kg: Vector, lag_s: Vector,
) -> None:  # fmt: skip
    """Write the learned values into a message's fields, the last eight arguments."""
    horizon_ns[0] = commands[0].horizon_ns
    assign(foreseen_error, error)
    assign(disturbance, belief.disturbance_nm)
    assign(friction, belief.coulomb_nm)
    if has_model:
        assign(viscous, belief.viscous_nm_s)
        inertia_factor[0] = 1.0 + estimate[INERTIA]
        payload_kg[0] = estimate[PAYLOAD]
        lag_s[0] = estimate[LAG]

"""The last gate before a torque leaves: finite, right-sized, within limits."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.limits import JointLimits, LimitCounts, limit_torques
from bus_schema.runtime.compiled import bind, compiled
from bus_schema.runtime.finite import all_finite

_NOT_FINITE = -1


class ControllerError(Exception):
    """Root of the errors of a running controller."""


class InvalidTorqueError(ControllerError, ArithmeticError):
    """A law returned something that is no torque.

    Attributes:
        law: name of the law.
        tick: cycle in which it happened.
    """

    def __init__(self, law: str, tick: int, explanation: str) -> None:
        super().__init__(f"law {law} returned {explanation} at tick {tick}")
        self.law = law
        self.tick = tick


class TorqueGuard:
    """Checks and limits torques.

    Args:
        law: name of the law, for error messages.
        limits: what the controller keeps within.

    Attributes:
        hits: limits that the newest torque or the motion ran into: a sum of
            `bus_schema.limits.Hit`.
        counts: how often each limit was hit.
    """

    def __init__(self, law: str, limits: JointLimits) -> None:
        self._law = law
        joints = limits.torque_nm.size
        self._table = limits.table()
        self._wanted: Vector = np.zeros(joints)
        self.hits = 0
        self.counts = LimitCounts()
        self.attach(np.zeros((2, joints)), np.zeros(joints))

    def attach(self, motion: Matrix, out: Vector) -> None:
        """Go by this motion from now on, and write the torques to send here.

        Args:
            motion: positions and velocities as rows, shape (2, joints).
            out: shape (joints,); read again as the torques before.
        """
        self._motion, self._out = motion, out
        self._limit = self._limit_of_law = self._limiting(self._wanted)
        self._of_law = self._wanted  # until it shows one

    def reset(self) -> None:
        """Forget the torque before."""
        self._out[:] = 0.0
        self.hits = 0

    def admit(self, torque: Vector, tick: int, step_s: float) -> Vector:
        """The torque to send, shape (joints,), N m.

        Raises:
            InvalidTorqueError: the shape is wrong or an entry is not finite.
        """
        if torque is self._of_law:
            hits = self._limit_of_law(step_s)
        else:
            self._require_vector(torque, tick)
            self._wanted[:] = torque
            hits = self._limit(step_s)
            self._expect(torque)
        if hits == _NOT_FINITE:
            raise InvalidTorqueError(self._law, tick, f"the torque {torque.tolist()}")
        self.hits = hits
        return self._out

    def _require_vector(self, torque: Vector, tick: int) -> None:
        if not isinstance(torque, np.ndarray) or torque.shape != self._out.shape:
            shape = getattr(torque, "shape", type(torque).__name__)
            raise InvalidTorqueError(
                self._law, tick, f"{shape} where shape {self._out.shape} is expected"
            )
        if torque.dtype != np.float64:
            raise InvalidTorqueError(self._law, tick, f"{torque.dtype} where float64 is expected")

    def _expect(self, torque: Vector) -> None:
        """Spare the law that returns one array over and over the checks and the copy."""
        if self._of_law is self._wanted and type(torque) is np.ndarray:
            self._of_law = torque
            self._limit_of_law = self._limiting(torque)

    def _limiting(self, wanted: Vector) -> Callable[[float], int]:
        return bind(_limit_finite, wanted, self._motion, self._table, self._out, free=["float64"])


@compiled
def _limit_finite(
    wanted: Vector, motion: Matrix, table: Matrix, previous_and_out: Vector, step_s: float
) -> int:
    if not all_finite(wanted):
        return _NOT_FINITE
    return limit_torques(wanted, motion, table, previous_and_out, step_s)

"""The last gate before a torque leaves: finite, right-sized, within limits."""

from __future__ import annotations

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.compiled import bind
from bus_schema.finite import all_finite
from bus_schema.limits import JointLimits, LimitCounts, limit_torques

_FLOAT64 = np.dtype(np.float64)  # to compare with this is ten times as fast as with the type


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
        self._is_finite = bind(all_finite, self._wanted)
        self.hits = 0
        self.counts = LimitCounts()
        self.attach(np.zeros((2, joints)), np.zeros(joints))

    def attach(self, motion: Matrix, out: Vector) -> None:
        """Go by this motion from now on, and write the torques to send here.

        Args:
            motion: positions and velocities as rows, shape (2, joints).
            out: shape (joints,); read again as the torques before.
        """
        self._out = out
        self._limit = bind(limit_torques, self._wanted, motion, self._table, out, free=["float64"])

    def reset(self) -> None:
        """Forget the torque before."""
        self._out[:] = 0.0
        self.hits = 0

    def admit(self, torque: Vector, tick: int, step_s: float) -> Vector:
        """The torque to send, shape (joints,), N m.

        Raises:
            InvalidTorqueError: the shape is wrong or an entry is not finite.
        """
        if not isinstance(torque, np.ndarray) or torque.shape != self._out.shape:
            shape = getattr(torque, "shape", type(torque).__name__)
            raise InvalidTorqueError(
                self._law, tick, f"{shape} where shape {self._out.shape} is expected"
            )
        if torque.dtype != _FLOAT64:
            raise InvalidTorqueError(self._law, tick, f"{torque.dtype} where float64 is expected")
        self._wanted[:] = torque
        if not self._is_finite():
            raise InvalidTorqueError(self._law, tick, f"the torque {torque.tolist()}")
        self.hits = self._limit(step_s)
        return self._out

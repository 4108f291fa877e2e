"""The last check before a torque is sent: finite, right shape, within limits."""

from __future__ import annotations

import numpy as np

from bus_schema.arrays import Matrix, Records, Vector
from bus_schema.limits import JointLimits, LimitCounts, limit_torques
from bus_schema.runtime.compiled import all_finite, bind, compiled
from controller.errors import ControllerError

_NOT_FINITE = -1
_FLOAT64 = np.dtype(np.float64)


class InvalidTorqueError(ControllerError, ArithmeticError):
    """A law returned an invalid torque.

    Attributes:
        law: name of the law.
        tick: cycle in which it happened.
    """

    def __init__(self, law: str, tick: int, explanation: str) -> None:
        super().__init__(f"law {law} returned {explanation} at tick {tick}")
        self.law = law
        self.tick = tick


class TorqueGuard:
    """Checks torques, and limits them.

    Args:
        law: name of the law, for error messages.
        limits: the controller's limits.
        motion: positions and velocities as rows, shape (2, joints), read at each `admit`.
        torque_nm: array for the torque to send, shape (joints,); it may be part of a message.

    Attributes:
        torque_nm: the newest torque to send, shape (joints,).
        hits: limits that the newest torque or the motion exceeded: a sum of
            `bus_schema.limits.Hit`.
        counts: how often each limit was hit.
    """

    def __init__(
        self, law: str, limits: JointLimits, motion: Matrix, torque_nm: Vector | None = None
    ) -> None:
        self._law = law
        joints = limits.torque_nm.size
        self._shape = limits.torque_nm.shape
        self._wanted: Vector = np.zeros(joints)
        self.torque_nm: Vector = np.zeros(joints) if torque_nm is None else torque_nm
        self._limit = bind(
            _limit_finite, self._wanted, motion, limits.packed(), self.torque_nm, free=["float64"]
        )
        self.hits = 0
        self.counts = LimitCounts()

    def reset(self) -> None:
        """Forget the previous torque."""
        self.torque_nm[:] = 0.0
        self.hits = 0

    def admit(self, torque: Vector, tick: int, step_s: float) -> Vector:
        """Compute `torque_nm`, and return it.

        Args:
            torque: the law's torque.
            tick: number of the cycle, for error messages.
            step_s: time since the previous torque; 0 for the first.

        Raises:
            InvalidTorqueError: the shape is wrong or an entry is not finite.
        """
        kind = getattr(torque, "dtype", None)
        # An unpickled array has an equal dtype, but as another object.
        is_float64 = kind is _FLOAT64 or (isinstance(kind, np.dtype) and kind == _FLOAT64)
        if not is_float64 or torque.shape != self._shape:
            raise InvalidTorqueError(self._law, tick, self._mismatch(torque))
        self._wanted[...] = torque
        hits = self._limit(step_s)
        if hits == _NOT_FINITE:
            raise InvalidTorqueError(self._law, tick, f"the torque {torque.tolist()}")
        self.hits = hits
        return self.torque_nm

    def _mismatch(self, torque: object) -> str:
        """Describe what a law returned instead of one float64 per joint."""
        shape = getattr(torque, "shape", type(torque).__name__)
        if shape == self._shape:
            return f"{getattr(torque, 'dtype', type(torque).__name__)} where float64 is expected"
        return f"{shape} where shape {self._shape} is expected"


@compiled
def _limit_finite(
    wanted: Vector, motion: Matrix, limits: Records, previous_and_out: Vector, step_s: float
) -> int:
    if not all_finite(wanted):
        return _NOT_FINITE
    return limit_torques(wanted, motion, limits, previous_and_out, step_s)

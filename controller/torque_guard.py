"""The last gate before a torque leaves: finite, right-sized, within limits."""

from __future__ import annotations

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.compiled import compiled
from bus_schema.finite import all_finite


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
        limits_nm: largest torque per joint, shape (joints,).
        rate_limits_nm_s: largest change per second and joint, shape (joints,); inf for none.
    """

    def __init__(self, law: str, limits_nm: Vector, rate_limits_nm_s: Vector) -> None:
        self._law = law
        self._limits = limits_nm
        self._rate_limits = rate_limits_nm_s
        self._out: Vector = np.zeros(limits_nm.size)

    def reset(self) -> None:
        """Forget the torque before."""
        self._out[:] = 0.0

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
        if torque.dtype != np.float64:
            raise InvalidTorqueError(self._law, tick, f"{torque.dtype} where float64 is expected")
        if not all_finite(torque):
            raise InvalidTorqueError(self._law, tick, f"the torque {torque.tolist()}")
        _limit(torque, self._limits, self._rate_limits, step_s, self._out)
        return self._out


@compiled
def _limit(
    torque: Vector, limits: Vector, rate_limits: Vector, step_s: float, previous_and_out: Vector
) -> None:
    for i in range(torque.size):
        limited = min(max(torque[i], -limits[i]), limits[i])
        if step_s > 0.0:
            change = rate_limits[i] * step_s
            limited = min(max(limited, previous_and_out[i] - change), previous_and_out[i] + change)
        previous_and_out[i] = limited

"""The last gate before a torque leaves: finite, right-sized, within limits."""

from __future__ import annotations

import numpy as np

from bus_schema.arrays import Vector


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
        self._upper = limits_nm
        self._lower = -limits_nm
        self._rate_limits = rate_limits_nm_s
        self._limits_rate = bool(np.any(np.isfinite(rate_limits_nm_s)))
        self._previous: Vector = np.zeros(limits_nm.size)
        self._out: Vector = np.zeros(limits_nm.size)

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
        if not np.isfinite(torque).all():
            raise InvalidTorqueError(self._law, tick, f"the torque {torque.tolist()}")
        np.clip(torque, self._lower, self._upper, out=self._out)
        if self._limits_rate and tick > 0:
            change = self._rate_limits * step_s
            np.clip(self._out, self._previous - change, self._previous + change, out=self._out)
        self._previous[:] = self._out
        return self._out

"""``franka_torque``: torques at 1 kHz; a lost one is held, 20 lost in a row stop the robot.

After libfranka (its documentation and headers). The torque's rate is checked on backward
differences. Torques are whole ones here: a Franka arm adds those of gravity itself. The first one
is therefore no step, unless the torque before it is given.
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.configuration import Positive
from plant_emulator.interfaces.franka import LOST, MOST_LOST, low_pass_share
from plant_emulator.interfaces.interface import LostCount, Stoppable
from plant_emulator.interfaces.settings import InterfaceSettings, Takes

_RATE = "controller_torque_discontinuity"
_ROUNDING = 1.0 + 1e-6


class FrankaTorque(Stoppable):
    """Torques of a Franka arm.

    Args:
        period_s: of a cycle.
        most_nm_s: largest rate of a torque.
        limiter: torques are changed to stay within it.
        filter_hz: of the low pass; inf for none.
    """

    def __init__(
        self, period_s: float, most_nm_s: float, *, limiter: bool, filter_hz: float
    ) -> None:
        self._most_nm, self._limiter = most_nm_s * period_s, limiter
        self._share = low_pass_share(period_s, filter_hz)
        self._lost = LostCount(MOST_LOST)

    def start(self, position_rad: Vector, torque_nm: Vector | None = None) -> None:
        """Begin, with the torque before the first one; without it, the first one is no step."""
        self._torque = np.full(position_rad.size, np.nan) if torque_nm is None else torque_nm
        self._lost.start()

    def step(self, target: Matrix | None, measured: Matrix) -> Vector:  # noqa: ARG002
        """Return the torque from this cycle on; the target has it as its only row."""
        torque_nm = None if target is None else target[0]
        if self._lost.is_over(arrived=target is not None):
            self.stop(LOST, -1, f"{MOST_LOST} torques in a row were late or lost")
        if torque_nm is not None:
            self._admit(torque_nm)
        return self._torque

    def _admit(self, torque_nm: Vector) -> None:
        before = np.where(np.isnan(self._torque), torque_nm, self._torque)
        wanted = before + self._share * (torque_nm - before)
        if self._limiter:
            wanted = np.clip(wanted, before - self._most_nm, before + self._most_nm)
        steps = np.abs(wanted - before)
        joint = int(steps.argmax())
        if steps[joint] > self._most_nm * _ROUNDING:
            words = f"{steps[joint]:.3g} N m in a cycle, of at most {self._most_nm:.3g}"
            self.stop(_RATE, joint, words)
        self._torque = wanted


class FrankaTorqueSettings(InterfaceSettings):
    """Torques at 1 kHz, with the limit of an FR3.

    Attributes:
        torque_rate_nm_s: largest change of a torque per second.
        limiter: torques are changed to stay within it.
        filter_hz: of the low pass; null for none.
    """

    rate_hz: ClassVar[float] = 1000.0
    torque_rate_nm_s: Positive = 1000.0
    limiter: bool = False
    filter_hz: Positive | None = None

    @property
    def takes(self) -> Takes:
        return "torque"

    def build(self, period_s: float) -> FrankaTorque:
        return FrankaTorque(
            period_s, self.torque_rate_nm_s, limiter=self.limiter,
            filter_hz=self.filter_hz or math.inf,
        )  # fmt: skip

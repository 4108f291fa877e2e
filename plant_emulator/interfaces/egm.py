"""``egm``: corrections of positions and velocities, filtered, until a time-out.

After the public drivers of ABB's externally guided motion: the robot moves at the velocity that was
sent, plus a gain times the distance to the position that was sent, through a low pass. Gain 0 is
pure velocity.
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.configuration import NonNegative, Positive
from plant_emulator.interfaces.interface import LostCount, Motion, Stoppable
from plant_emulator.interfaces.settings import InterfaceSettings, Takes, low_pass_lag_s
from plant_emulator.interfaces.velocity_integrator import VelocityIntegrator

TIMEOUT = "egm_communication_timeout"


class Egm(Stoppable):
    """Corrections with a gain, a filter and a time-out that is a fault.

    Args:
        period_s: of a cycle.
        gain_per_s: of the distance to the target.
        filter_hz: bandwidth of the low pass.
        timeout_s: time without a target after which the robot stops.
    """

    def __init__(
        self, period_s: float, gain_per_s: float, filter_hz: float, timeout_s: float
    ) -> None:
        self._gain_per_s, self._timeout_s = gain_per_s, timeout_s
        self._joints = VelocityIntegrator(period_s)
        self._silence = LostCount.until(timeout_s, period_s)
        self._share = 1.0 - math.exp(-2.0 * math.pi * filter_hz * period_s)

    def start(self, position_rad: Vector) -> None:
        self._joints.start(position_rad)
        self._silence.start()
        self._target: Matrix = np.stack([position_rad, np.zeros(position_rad.size)])

    def step(self, target: Matrix | None, measured: Matrix) -> Motion:  # noqa: ARG002
        if target is not None:
            self._target = target.copy()
        if self._silence.is_over(arrived=target is not None):
            self.stop(TIMEOUT, -1, f"no correction for {1e3 * self._timeout_s:g} ms")
        away = self._target[0] - self._joints.position
        away[np.isnan(away)] = 0.0  # a target that gives a velocity alone
        wanted = self._target[1] + self._gain_per_s * away
        return self._joints.change(self._share * (wanted - self._joints.velocity))


class EgmSettings(InterfaceSettings):
    """Corrections, as ABB's externally guided motion takes them.

    Attributes:
        gain_per_s: of the distance to a position; 0 for velocities alone.
        filter_hz: bandwidth of the low pass.
        timeout_ms: time without a correction after which the robot stops.
    """

    rate_hz: ClassVar[float] = 250.0
    gain_per_s: NonNegative = 20.0
    filter_hz: Positive = 20.0
    timeout_ms: Positive = 200.0

    @property
    def takes(self) -> Takes:
        return "position" if self.gain_per_s else "velocity"

    def lag_s(self, period_s: float, targets_s: float) -> float:  # noqa: ARG002
        return low_pass_lag_s(self.filter_hz) if not self.gain_per_s else 0.0

    def build(self, period_s: float) -> Egm:
        return Egm(period_s, self.gain_per_s, self.filter_hz, 1e-3 * self.timeout_ms)

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
from plant_emulator.interfaces.interface import Integrator, Motion, Reflexes
from plant_emulator.interfaces.missing_targets import Silence
from plant_emulator.interfaces.settings import InterfaceSettings, Takes

TIMEOUT = "egm_communication_timeout"


class Egm(Reflexes):
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
        self._period_s, self._gain_per_s, self._timeout_s = period_s, gain_per_s, timeout_s
        self._share = 1.0 - math.exp(-2.0 * math.pi * filter_hz * period_s)
        self._silence = Silence(period_s, timeout_s)

    def start(self, position_rad: Vector) -> None:
        self._joints = Integrator(position_rad)
        self._target: Matrix = np.stack([position_rad, np.zeros(position_rad.size)])
        self._silence.start()

    def step(self, target: Matrix | None, measured: Matrix) -> Motion:  # noqa: ARG002
        if target is not None:
            self._target = target.copy()
        if self._silence.note(has_target=target is not None):
            self.stop(TIMEOUT, f"no correction for {1e3 * self._timeout_s:g} ms")
        joints = self._joints
        wanted = self._target[1] + self._gain_per_s * (self._target[0] - joints.position_rad)
        return joints.step(self._share * (wanted - joints.velocity_rad_s), self._period_s)


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

    def lag_s(self, period_s: float) -> float:  # noqa: ARG002
        return 1.0 / (2.0 * math.pi * self.filter_hz) if not self.gain_per_s else 0.0

    def build(self, period_s: float) -> Egm:
        return Egm(period_s, self.gain_per_s, self.filter_hz, 1e-3 * self.timeout_ms)

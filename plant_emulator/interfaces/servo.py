"""``servo``: a hobby servo, or a position or velocity actuator of an MJCF file.

The drives' own loops have the actuator's gains (``plant.drive_feedback``), and know nothing of the
arm: it sags. A target within the dead band of the last one changes nothing; targets have the
resolution of the bus.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.configuration import NonNegative
from plant_emulator.interfaces.interface import Motion, Stoppable
from plant_emulator.interfaces.settings import InterfaceSettings


class Servo(Stoppable):
    """Targets with a dead band and a resolution.

    Args:
        dead_band_rad: smallest change of a target that counts.
        resolution_rad: step of targets; 0 for exact ones.
    """

    def __init__(self, dead_band_rad: float, resolution_rad: float) -> None:
        self._dead_band_rad, self._resolution_rad = dead_band_rad, resolution_rad

    def start(self, position_rad: Vector) -> None:
        self._position: Vector = position_rad.copy()
        self._zero: Vector = np.zeros(position_rad.size)

    def step(self, target: Matrix | None, measured: Matrix) -> Motion:  # noqa: ARG002
        if target is not None:
            wanted = target[0]
            if (step := self._resolution_rad) > 0.0:
                wanted = step * np.round(wanted / step)
            counts = np.abs(wanted - self._position) > self._dead_band_rad
            self._position = np.where(counts, wanted, self._position)
        return Motion(self._position, self._zero, self._zero)


class ServoSettings(InterfaceSettings):
    """Positions for the drives' own loops, whose gains ``plant.drive_feedback`` has.

    Attributes:
        dead_band_rad: smallest change of a target that counts.
        resolution_rad: step of targets on the bus; 0 for exact ones.
    """

    rate_hz: ClassVar[float] = 50.0
    knows_arm: ClassVar[bool] = False
    dead_band_rad: NonNegative = 0.0
    resolution_rad: NonNegative = 0.0

    def lag_s(self, period_s: float, targets_s: float) -> float:  # noqa: ARG002
        return 0.5 * period_s

    def build(self, period_s: float) -> Servo:  # noqa: ARG002
        return Servo(self.dead_band_rad, self.resolution_rad)

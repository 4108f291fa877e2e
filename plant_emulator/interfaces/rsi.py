"""``rsi``: a packet with positions in every cycle of 4 ms; late ones are counted.

After the public drivers of KUKA's robot sensor interface: with the hold option, the last correction
stays while packets are late; without, a late packet sets it back to zero, where the robot was at
the start. Too many late packets in a row are a fault.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from bus_schema.arrays import Matrix, Vector
from bus_schema.configuration import Whole
from plant_emulator.interfaces.interface import LostCount, Motion, Stoppable
from plant_emulator.interfaces.response import Response
from plant_emulator.interfaces.settings import ResponseSettings

TIMEOUT = "rsi_late_packets"


class Rsi(Stoppable):
    """Positions with a count of late packets.

    Args:
        response: of the joints.
        most_late: late packets in a row that are a fault.
        holds: the last correction stays while packets are late.
    """

    def __init__(self, response: Response, most_late: int, *, holds: bool) -> None:
        self._response, self._holds = response, holds
        self._late = LostCount(most_late)

    def start(self, position_rad: Vector) -> None:
        self._response.start(position_rad)
        self._home: Matrix = np.stack([position_rad, np.zeros(position_rad.size)])
        self._target = self._home
        self._late.start()

    def step(self, target: Matrix | None, measured: Matrix) -> Motion:  # noqa: ARG002
        if target is not None:
            self._target = target.copy()
        elif not self._holds:
            self._target = self._home
        if self._late.is_over(arrived=target is not None):
            self.stop(TIMEOUT, -1, f"{self._late.lost} packets in a row were late")
        return self._response.step(self._target)


class RsiSettings(ResponseSettings):
    """Packets every 4 ms, as KUKA's robot sensor interface takes them.

    Attributes:
        hold_on: the last correction stays while packets are late.
        most_late: late packets in a row that are a fault.
    """

    rate_hz: ClassVar[float] = 250.0
    usual_ms: ClassVar[tuple[float, float]] = (8.0, 12.0)
    hold_on: bool = True
    most_late: Annotated[Whole, Field(ge=1)] = 100

    def build(self, period_s: float) -> Rsi:
        return Rsi(self.response(period_s), self.most_late, holds=self.hold_on)

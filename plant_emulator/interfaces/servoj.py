"""``servoj``: positions, which a robot smooths over its lookahead time.

After the external control script of Universal_Robots_Client_Library: a missing target is
extrapolated with the last targets' speed until the read times out, then ``stopj`` brakes. Targets
that need more than 20 rad/s are ignored. The law behind lookahead and gain is unpublished:
`Response` stands for it.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from bus_schema.arrays import Matrix, Vector
from bus_schema.configuration import Number, Positive
from plant_emulator.interfaces.interface import LostCount, Motion, Stoppable
from plant_emulator.interfaces.response import Response
from plant_emulator.interfaces.settings import ResponseSettings, TimeoutMs

_FASTEST_RAD_S = 20.0
_DEAD_MS, _SMOOTHING, _PER_GAIN = 4.0, 2.0 / 3.0, 200.0
"""Dead time; share of the lookahead that is lag, and its growth with a smaller gain."""


class ServoJ(Stoppable):
    """Positions with extrapolation, time-out and a response.

    Args:
        period_s: of a cycle.
        response: of the joints.
        timeout_s: time without a target after which the robot stops.
        stop_rad_s2: deceleration of that stop.
    """

    def __init__(
        self, period_s: float, response: Response, timeout_s: float, stop_rad_s2: float
    ) -> None:
        self._period_s, self._response = period_s, response
        self._silence, self._most = LostCount.until(timeout_s, period_s), stop_rad_s2 * period_s

    def start(self, position_rad: Vector) -> None:
        self._response.start(position_rad)
        self._target = np.stack([position_rad, np.zeros(position_rad.size)])
        self._silence.start()
        self._has_target = False

    def step(self, target: Matrix | None, measured: Matrix) -> Motion:  # noqa: ARG002
        since_s = self._period_s * (self._silence.lost + 1)
        arrived = target is not None and self._is_reachable(target[0], since_s)
        brakes = self._silence.is_over(arrived=arrived)
        if target is not None and arrived:
            speed = (target[0] - self._target[0]) / since_s if self._has_target else 0.0
            self._target[0], self._target[1], self._has_target = target[0], speed, True
        else:
            self._go_on(brakes=brakes)
        return self._response.step(self._target)

    def _is_reachable(self, position: Vector, since_s: float) -> bool:
        needed = np.abs(position - self._target[0]).max() / since_s
        return not self._has_target or bool(needed <= _FASTEST_RAD_S)

    def _go_on(self, *, brakes: bool) -> None:
        """Extrapolate the target; brake after the time-out."""
        if brakes:
            self._target[1] -= np.clip(self._target[1], -self._most, self._most)
        self._target[0] += self._period_s * self._target[1]


class ServoJSettings(ResponseSettings):
    """Joint positions, as Universal Robots' ``servoj`` takes them.

    The usual response is ours: it has the one public figure, 34 ms in all with a lookahead of
    0.03 s and a gain of 1200, of which 4 to 6 are the link's. ``latency`` measures yours.

    Attributes:
        lookahead_time_s: over which the robot smooths.
        gain: of its position loop.
        timeout_ms: time without a target after which the robot stops.
        stop_rad_s2: deceleration of that stop.
    """

    goes_on: ClassVar[bool] = True
    lookahead_time_s: Annotated[Number, Field(ge=0.03, le=0.2)] = 0.1
    gain: Annotated[Number, Field(ge=100, le=2000)] = 300.0
    timeout_ms: TimeoutMs = 20.0
    stop_rad_s2: Positive = 4.0

    @property
    def response_ms(self) -> tuple[float, float]:
        smoothing_ms = 1e3 * self.lookahead_time_s * (_SMOOTHING + _PER_GAIN / self.gain)
        dead_ms = _DEAD_MS if self.dead_time_ms == "auto" else self.dead_time_ms
        return dead_ms, smoothing_ms if self.lag_ms == "auto" else self.lag_ms

    def build(self, period_s: float) -> ServoJ:
        timeout_s = 1e-3 * self.timeout_ms
        return ServoJ(period_s, self.response(period_s), timeout_s, self.stop_rad_s2)

"""Base of the sections of ``plant.interface``, one for each kind of robot interface."""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from bus_schema.configuration import NonNegative, Positive, StrictModel
from plant_emulator.interfaces.interface import RobotInterface
from plant_emulator.interfaces.response import Response

Takes = Literal["torque", "position", "velocity"]
TORQUE: Takes = "torque"
TimeoutMs = Annotated[Positive, Field(le=200)]
"""Time without a target after which a Universal Robots controller stops: at most 200 ms."""
Automatic = NonNegative | Literal["auto"]


def low_pass_lag_s(filter_hz: float) -> float:
    """Return how long a low pass of first order is behind a ramp; 0 for inf Hz."""
    return 1.0 / (2.0 * math.pi * filter_hz)


class InterfaceSettings(StrictModel):
    """Settings of a kind of interface.

    Attributes:
        rate_hz: usual cycles per second of the robot's controller.
        knows_arm: torques of the planned motion go ahead to the drives.
        goes_on: the motion goes on in cycles without a target; otherwise the last one stays.
    """

    rate_hz: ClassVar[float] = 500.0
    knows_arm: ClassVar[bool] = True
    goes_on: ClassVar[bool] = False

    @property
    def takes(self) -> Takes:
        """Content of the commands that the robot takes."""
        return "position"

    def lag_s(self, period_s: float, targets_s: float) -> float | None:  # noqa: ARG002
        """Return the lag of joints that move steadily behind what a cycle reads, if it is known.

        Args:
            period_s: of its cycles.
            targets_s: time from one target to the next, at least a cycle.
        """
        return 0.0

    @abstractmethod
    def build(self, period_s: float) -> RobotInterface:
        """Return a new controller of the robot.

        Args:
            period_s: of its cycles, by its own clock.
        """


class ResponseSettings(InterfaceSettings):
    """Settings of robots whose joints respond with a dead time and second order.

    Attributes:
        dead_time_ms: time in which a target has no effect; ``auto`` for the kind's usual one.
        lag_ms: further lag of joints that move steadily; likewise.
    """

    usual_ms: ClassVar[tuple[float, float]] = (0.0, 0.0)
    dead_time_ms: Automatic = "auto"
    lag_ms: Automatic = "auto"

    @property
    def response_ms(self) -> tuple[float, float]:
        """Dead time and lag."""
        dead, lag = self.usual_ms
        return (
            dead if self.dead_time_ms == "auto" else self.dead_time_ms,
            lag if self.lag_ms == "auto" else self.lag_ms,
        )

    def lag_s(self, period_s: float, targets_s: float) -> float | None:  # noqa: ARG002
        return self.response_lag_s(period_s)

    def response_lag_s(self, period_s: float) -> float:
        """Return the lag behind targets that come in each cycle."""
        dead_ms, lag_ms = self.response_ms
        return 1e-3 * (dead_ms + lag_ms) + (0.5 * period_s if lag_ms else 0.0)

    def response(self, period_s: float) -> Response:
        """Return the joints' response."""
        dead_ms, lag_ms = self.response_ms
        return Response(period_s, 1e-3 * dead_ms, 1e-3 * lag_ms)

"""``speedj``: joint velocities, which a robot repeats until it stops without new ones.

The robot accelerates with a limit. Without a new velocity for the time-out, it decelerates to rest,
as a Universal Robots controller with ``speedj`` and then ``stopj`` does (external control script,
Universal_Robots_Client_Library).
"""

from __future__ import annotations

import math

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.configuration import Positive
from plant_emulator.interfaces.interface import LostCount, Motion, Stoppable
from plant_emulator.interfaces.settings import InterfaceSettings, Takes, TimeoutMs
from plant_emulator.interfaces.velocity_integrator import VelocityIntegrator


class SpeedJ(Stoppable):
    """Velocities with a limit of acceleration.

    Args:
        period_s: of a cycle.
        acceleration_rad_s2: largest acceleration; inf for joints that follow within
            a cycle.
        timeout_s: time without a target after which the robot stops.
        stop_rad_s2: deceleration of that stop.
    """

    def __init__(
        self, period_s: float, acceleration_rad_s2: float, timeout_s: float, stop_rad_s2: float
    ) -> None:
        self._joints = VelocityIntegrator(period_s)
        self._silence = LostCount.until(timeout_s, period_s)
        self._most, self._stop = acceleration_rad_s2 * period_s, stop_rad_s2 * period_s

    def start(self, position_rad: Vector) -> None:
        self._joints.start(position_rad)
        self._silence.start()
        self._wanted = np.zeros(position_rad.size)

    def step(self, target: Matrix | None, measured: Matrix) -> Motion:  # noqa: ARG002
        if target is not None:
            self._wanted[:] = target[1]
        stops = self._silence.is_over(arrived=target is not None)
        wanted, most = (0.0 * self._wanted, self._stop) if stops else (self._wanted, self._most)
        return self._joints.change(np.clip(wanted - self._joints.velocity, -most, most))


class SpeedJSettings(InterfaceSettings):
    """Joint velocities, as Universal Robots' ``speedj`` takes them.

    Attributes:
        acceleration_rad_s2: largest acceleration of a joint.
        ideal: the joints follow velocities within a cycle, whatever it takes.
        timeout_ms: time without a velocity after which the robot stops.
        stop_rad_s2: deceleration of that stop.
    """

    acceleration_rad_s2: Positive = 40.0
    ideal: bool = False
    timeout_ms: TimeoutMs = 20.0
    stop_rad_s2: Positive = 4.0

    @property
    def takes(self) -> Takes:
        return "velocity"

    def lag_s(self, period_s: float, targets_s: float) -> float:  # noqa: ARG002
        return 0.5 * period_s

    def build(self, period_s: float) -> SpeedJ:
        most = math.inf if self.ideal else self.acceleration_rad_s2
        return SpeedJ(period_s, most, 1e-3 * self.timeout_ms, self.stop_rad_s2)

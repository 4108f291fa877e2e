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
from plant_emulator.interfaces.interface import Integrator, Motion, Reflexes
from plant_emulator.interfaces.missing_targets import Silence
from plant_emulator.interfaces.settings import InterfaceSettings, Takes, TimeoutMs


class SpeedJ(Reflexes):
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
        self._period_s, self._most = period_s, acceleration_rad_s2
        self._braking, self._silence = stop_rad_s2, Silence(period_s, timeout_s)

    def start(self, position_rad: Vector) -> None:
        self._joints = Integrator(position_rad)
        self._wanted: Vector = np.zeros(position_rad.size)
        self._silence.start()

    def step(self, target: Matrix | None, measured: Matrix) -> Motion:  # noqa: ARG002
        if target is not None:
            self._wanted = target[1].copy()
        most = self._most * self._period_s
        if self._silence.note(has_target=target is not None):
            self._wanted, most = 0.0 * self._wanted, self._braking * self._period_s
        change = np.clip(self._wanted - self._joints.velocity_rad_s, -most, most)
        return self._joints.step(change, self._period_s)


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

    def lag_s(self, period_s: float) -> float:
        return 0.5 * period_s

    def build(self, period_s: float) -> SpeedJ:
        most = math.inf if self.ideal else self.acceleration_rad_s2
        return SpeedJ(period_s, most, 1e-3 * self.timeout_ms, self.stop_rad_s2)

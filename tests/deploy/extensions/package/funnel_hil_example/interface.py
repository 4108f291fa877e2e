"""A robot that moves at one speed, with the sign of the velocity that it is told."""

import numpy as np

from plant_emulator.interfaces.interface import Motion
from plant_emulator.interfaces.settings import InterfaceSettings


class Jog:
    """Its controller."""

    def __init__(self, period_s, speed_rad_s):
        self._period_s, self._speed, self.reflex = period_s, speed_rad_s, None

    def start(self, position_rad):
        self._position, self._velocity = position_rad.copy(), 0.0 * position_rad

    def step(self, target, measured):
        if target is not None:
            self._velocity = self._speed * np.sign(target[1])
        motion = Motion(self._position.copy(), self._velocity.copy(), 0.0 * self._velocity)
        self._position += self._period_s * self._velocity
        return motion


class JogSettings(InterfaceSettings):
    """Its settings."""

    speed_rad_s: float = 0.1

    @property
    def takes(self):
        return "velocity"

    def build(self, period_s):
        return Jog(period_s, self.speed_rad_s)

"""Motion of a Universal Robots arm under `servoj`, `speedj` and `stopj`, one cycle at a time."""

from __future__ import annotations

import numpy as np

from bus_schema.arrays import Matrix, Vector
from plant_emulator.interfaces.interface import Motion, Stoppable
from plant_emulator.interfaces.response import Response
from plant_emulator.interfaces.servoj import ServoJSettings
from plant_emulator.interfaces.velocity_integrator import VelocityIntegrator


class ScriptMotion(Stoppable):
    """Motion that the commands of a program ask for; it goes on until the next command.

    Args:
        period_s: of a cycle.
        settings: of `servoj`, for what a command does not say.
    """

    def __init__(self, period_s: float, settings: ServoJSettings) -> None:
        self._period_s, self._settings = period_s, settings
        self._servo: Response | None = None
        self.servo_settings: dict[str, float] = {}
        self.position: Vector = np.zeros(0)
        self.velocity: Vector = np.zeros(0)
        self._wanted: Vector = np.zeros(0)
        self._most_rad_s2 = settings.stop_rad_s2

    def start(self, position_rad: Vector) -> None:
        """Begin at rest."""
        self.position, self.velocity = position_rad.copy(), np.zeros(position_rad.size)
        self._wanted, self._servo = np.zeros(position_rad.size), None

    @property
    def target_rad(self) -> Vector:
        """Position that a servo command asks for, shape (joints,); NaN without one."""
        if self._servo is None:
            return np.full(self.position.size, np.nan)
        return self._wanted

    def servo(self, position_rad: Vector, lookahead_s: float, gain: float) -> None:
        """Follow a position, from the next cycle on."""
        given = {"lookahead_time_s": lookahead_s, "gain": gain}
        if self._servo is None or self.servo_settings != given:
            self._servo = self._settings.model_copy(update=given).response(self._period_s)
            self._servo.start(self.position)
            self._servo.velocity, self.servo_settings = self.velocity.copy(), given
        self._wanted = position_rad

    def speed(self, velocity_rad_s: Vector, acceleration_rad_s2: float) -> None:
        """Follow a velocity."""
        self._servo, self._wanted = None, velocity_rad_s
        self._most_rad_s2 = acceleration_rad_s2

    def brake(self, deceleration_rad_s2: float) -> None:
        """Stop."""
        self.speed(np.zeros(self.position.size), deceleration_rad_s2)

    def step(self, target: Matrix | None, measured: Matrix) -> Motion:  # noqa: ARG002 (commands)
        if self._servo is not None:
            motion = self._servo.step(np.stack([self._wanted, np.zeros(self._wanted.size)]))
            self.position, self.velocity = self._servo.position, self._servo.velocity
            return motion
        joints = VelocityIntegrator(self._period_s)
        joints.position, joints.velocity = self.position, self.velocity
        most = self._most_rad_s2 * self._period_s
        motion = joints.change(np.clip(self._wanted - self.velocity, -most, most))
        self.position, self.velocity = joints.position, joints.velocity
        return motion

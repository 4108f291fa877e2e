"""What stands between the bus and the ideal joints: encoders and actuators."""

from __future__ import annotations

import math

import numpy as np

from bus_schema.arrays import Matrix
from bus_schema.configuration import expand
from bus_schema.robot_description import RobotDescription
from bus_schema.runtime.compiled import copying
from plant_emulator.configuration import ActuatorConfiguration, EncoderConfiguration


class Encoders:
    """Positions of limited resolution, velocities with noise.

    Args:
        configuration: section ``plant.encoder`` of the scenario.
        motion: true positions and velocities as rows, shape (2, joints), at each `read`.
        random: source of the noise.

    Attributes:
        shown: what the encoders show, likewise.
    """

    def __init__(
        self, configuration: EncoderConfiguration, motion: Matrix, random: np.random.Generator
    ) -> None:
        joints = motion.shape[1]
        self._resolution = expand(
            configuration.resolution_rad, joints, "plant.encoder.resolution_rad"
        )
        self._noise = expand(
            configuration.velocity_noise_rad_s, joints, "plant.encoder.velocity_noise_rad_s"
        )
        self._is_coarse = self._resolution > 0.0
        self._quantises = bool(self._is_coarse.any())
        self._is_noisy = bool((self._noise > 0.0).any())
        self._random = random
        self.shown: Matrix = np.zeros_like(motion)
        self._copy = copying(motion, self.shown)

    def read(self) -> None:
        """Bring `shown` up to date."""
        self._copy()
        if self._quantises:
            position = self.shown[0]
            counts = np.round(position[self._is_coarse] / self._resolution[self._is_coarse])
            position[self._is_coarse] = counts * self._resolution[self._is_coarse]
        if self._is_noisy:
            self.shown[1] += self._noise * self._random.standard_normal(self.shown.shape[1])


class ActuatorLimits:
    """Saturation and lag of the actuators, as the physics step takes them.

    Attributes:
        saturation_nm: shape (joints,).
        lag_factor: share of the difference to the commanded torque that is left after a substep.
    """

    def __init__(
        self, configuration: ActuatorConfiguration, robot: RobotDescription, substep_s: float
    ) -> None:
        if configuration.saturation_nm is None:
            self.saturation_nm = robot.effort_limits_nm
        else:
            self.saturation_nm = expand(
                configuration.saturation_nm, robot.joints, "plant.actuator.saturation_nm"
            )
        lag_s = configuration.lag_ms * 1e-3
        self.lag_factor = math.exp(-substep_s / lag_s) if lag_s > 0.0 else 0.0

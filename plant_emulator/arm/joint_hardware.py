"""The joints' encoders."""

from __future__ import annotations

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.configuration import expand
from bus_schema.runtime.compiled import bind, compiled, copying
from plant_emulator.configuration import EncoderConfiguration

_BLOCK = 256
"""Reads for which noise is drawn at once: the same numbers, in a tenth of the time."""


class Encoders:
    """Positions of limited resolution, velocities with noise.

    Args:
        configuration: section ``plant.encoder`` of the scenario.
        motion: true positions and velocities as rows, shape (2, joints), at each `read`.
        random: source of the noise.

    Attributes:
        shown: the encoders' readings, same shape.
    """

    def __init__(
        self, configuration: EncoderConfiguration, motion: Matrix, random: np.random.Generator
    ) -> None:
        joints = motion.shape[1]
        resolution = expand(configuration.resolution_rad, joints, "plant.encoder.resolution_rad")
        noise = expand(
            configuration.velocity_noise_rad_s, joints, "plant.encoder.velocity_noise_rad_s"
        )
        self._is_noisy = bool((noise > 0.0).any())
        self._is_ideal = not (self._is_noisy or (resolution > 0.0).any())
        self._random, self._reads = random, 0
        self._normals: Matrix = np.zeros((_BLOCK, joints))
        self.shown: Matrix = np.zeros_like(motion)
        self._copy = copying(motion, self.shown)
        self._show = bind(
            _show, motion, resolution, noise, self._normals, self.shown, free=["int64"]
        )

    def read(self) -> None:
        """Update `shown`."""
        if self._is_ideal:
            self._copy()
            return
        row = self._reads % _BLOCK
        if self._is_noisy and row == 0:
            self._random.standard_normal(out=self._normals)
        self._show(row)
        self._reads += 1


@compiled
def _show(
    motion: Matrix, resolution: Vector, noise: Vector, normals: Matrix, shown: Matrix, row: int
) -> None:
    """Write the encoders' readings of a motion, with a row of random numbers."""
    for i in range(resolution.size):
        shown[0, i] = motion[0, i]
        if resolution[i] > 0.0:
            shown[0, i] = np.rint(motion[0, i] / resolution[i]) * resolution[i]
        shown[1, i] = motion[1, i] + noise[i] * normals[row, i]

"""A fault of an encoder: it counts too many or too few increments per turn."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from bus_schema.arrays import Vector
from bus_schema.configuration import Positive
from plant_emulator.faults.arm_faults import EncoderFault


class EncoderScaled(EncoderFault):
    """Attributes: factor: by which position and velocity are wrong."""

    kind: Literal["encoder_scaled"]
    factor: Positive

    def faulty(self, now: Vector, _first: Vector, _random: np.random.Generator) -> ArrayLike:
        return self.factor * now

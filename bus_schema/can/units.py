"""What the numbers in CiA 402 frames mean: increments of the encoder, thousandths of a torque."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Vector
from bus_schema.configuration import ConfigurationError, expand
from bus_schema.link.can_configuration import CanConfiguration
from bus_schema.robot_description import RobotDescription

PEAK_TO_RATED = 32.0
"""Effort limit to rated torque by default: the limit is 32000 ‰, nearly all that 16 bits hold."""

_WORD = np.iinfo(np.int16)
_NM_PER_MILLE_MNM = 1e-6


def rated_torque_nm(can: CanConfiguration, robot: RobotDescription) -> Vector:
    """Rated torque of each drive, shape (joints,).

    Raises:
        ConfigurationError: it is not given, and the URDF has no effort limit to take it from.
    """
    if can.rated_torque_nm is not None:
        return expand(can.rated_torque_nm, robot.joints, "link.can.rated_torque_nm")
    for name, limit in zip(robot.joint_names, robot.effort_limits_nm, strict=True):
        if not math.isfinite(limit):
            allowed = f"must be given: the URDF has no effort limit for joint {name}"
            raise ConfigurationError("link.can.rated_torque_nm", None, allowed)
    return np.asarray(robot.effort_limits_nm / PEAK_TO_RATED)


class DriveUnits:
    """Units of a robot's CiA 402 drives.

    Args:
        counts_per_turn: increments per turn of the joint.
        rated_nm: rated torques, shape (joints,); drives know them in whole mN m.

    Attributes:
        rad_per_count: angle of an increment.
        rated_mnm: rated torques as object 0x6076 has them, shape (joints,).
    """

    def __init__(self, counts_per_turn: int, rated_nm: Vector) -> None:
        self.rad_per_count = 2.0 * math.pi / counts_per_turn
        self.rated_mnm: NDArray[np.int64] = np.rint(rated_nm * 1000.0).astype(np.int64)
        self._nm_per_mille = self.rated_mnm * _NM_PER_MILLE_MNM

    def torque_words(self, torque_nm: Vector) -> list[int]:
        """Torques per mille of the rated ones: to the nearest, within 16 bits."""
        words = np.rint(torque_nm / self._nm_per_mille)
        return [int(word) for word in np.clip(words, _WORD.min, _WORD.max)]

    def torque_nm(self, joint: int, word: int) -> float:
        """The torque that a word stands for."""
        return word * float(self._nm_per_mille[joint])

"""The loop that drives close at every physics substep, see `bus_schema.drive_feedback`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.configuration import expand
from bus_schema.drive_feedback import DriveGains, drive_torque
from bus_schema.runtime.compiled import compiled
from plant_emulator.configuration import EncoderConfiguration

_NOISE_ROWS = 16_381
"""Noise repeats after so many substeps: seconds, and no multiple of any tick."""


class DriveLoop(NamedTuple):
    """State of the drives' own loop, for compiled code.

    Attributes:
        gains: stiffness and damping.
        target: position as of the stamp, rad, and velocity, rad/s, as rows; shape (2, joints).
        stamp_s: of the state that the target's command answers, shape (1,); NaN without a target.
        resolution_rad: of the drives' own encoders, 0 for exact ones; shape (joints,).
        noise_rad_s: the encoders' noise of velocities, shape (rows, joints).
        substep: index of the noise's next row, shape (1,).
    """

    gains: DriveGains
    target: Matrix
    stamp_s: Vector
    resolution_rad: Vector
    noise_rad_s: Matrix
    substep: NDArray[np.int64]


def drive_loop(
    gains: DriveGains, encoder: EncoderConfiguration, random: np.random.Generator
) -> DriveLoop:
    """Return drives without a target."""
    joints = gains.stiffness_nm_rad.size
    key = "plant.drive_feedback.encoder"
    resolution = expand(encoder.resolution_rad, joints, f"{key}.resolution_rad")
    deviation = expand(encoder.velocity_noise_rad_s, joints, f"{key}.velocity_noise_rad_s")
    rows = _NOISE_ROWS if deviation.any() else 1
    noise = deviation * random.standard_normal((rows, joints)) if deviation.any() else None
    return DriveLoop(
        gains, np.zeros((2, joints)), np.full(1, np.nan), resolution,
        np.zeros((rows, joints)) if noise is None else noise, np.zeros(1, np.int64),
    )  # fmt: skip


def idle(drive: DriveLoop) -> DriveLoop:
    """Return the same drives without their loop."""
    return drive._replace(gains=drive.gains._replace(is_active=False))


@compiled
def add_drive_torques(motion: Matrix, time_s: float, drive: DriveLoop, torques: Vector) -> None:
    """Add the torques of the drives' own loop; nothing without a target.

    Args:
        motion: true positions and velocities as rows, shape (2, joints).
        time_s: start of the substep.
        drive: the drives.
        torques: N m, shape (joints,), changed in place.
    """
    age_s = time_s - drive.stamp_s[0]
    if np.isnan(age_s):
        return
    row = drive.substep[0] % drive.noise_rad_s.shape[0]
    drive.substep[0] += 1
    for i in range(torques.size):
        position, resolution = motion[0, i], drive.resolution_rad[i]
        if resolution > 0.0:
            position = resolution * np.rint(position / resolution)
        velocity = motion[1, i] + drive.noise_rad_s[row, i]
        target_velocity = drive.target[1, i]
        target = drive.target[0, i] + age_s * target_velocity
        torques[i] += drive_torque(target, target_velocity, position, velocity, drive.gains, i)

"""A loop closed at the drive: the torque that a drive adds around a moving target.

A command carries a torque τ and a line q*(t) = q*₀ + v* (t − t₀), t₀ being the stamp of the state
that it answers. Between commands the drive asks its motor for

    τ + k_p (q*(t) − q) + k_d (v* − q̇)

as drives with the MIT mini-cheetah's protocol, moteus, ODrive's position mode with feed-forward and
CiA 402's cyclic synchronous position mode with torque offset do. Both sides must agree on it: the
drive acts on it, and a predictor foresees it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.runtime.compiled import compiled


class DriveGains(NamedTuple):
    """Gains of the loop inside a drive; arrays of shape (joints,).

    Attributes:
        is_active: whether any gain is above zero.
        stiffness_nm_rad: k_p.
        damping_nm_s: k_d.
    """

    is_active: bool
    stiffness_nm_rad: Vector
    damping_nm_s: Vector


def no_drive_feedback(joints: int) -> DriveGains:
    """Return the gains of a drive that follows torques alone."""
    return DriveGains(False, np.zeros(joints), np.zeros(joints))


def critically_damped(inertia_kg_m2: Vector, bandwidth_rad_s: float) -> DriveGains:
    """Return k_p = I ω² and k_d = 2 I ω for joints with these inertias, shape (joints,)."""
    stiffness = inertia_kg_m2 * bandwidth_rad_s**2
    return DriveGains(True, stiffness, 2.0 * inertia_kg_m2 * bandwidth_rad_s)


@compiled
def drive_torque(
    target: float, target_velocity: float, position: float, velocity: float, gains: DriveGains,
    joint: int,
) -> float:  # fmt: skip
    """Return k_p (q* − q) + k_d (v* − q̇) of a joint, N m; positions in rad, speeds in rad/s."""
    stiffness: float = gains.stiffness_nm_rad[joint]
    damping: float = gains.damping_nm_s[joint]
    return stiffness * (target - position) + damping * (target_velocity - velocity)

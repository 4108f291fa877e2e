"""A loop closed at the drive: what a drive adds to a torque of its own, around a target on the way.

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
    """What a drive adds of its own; arrays of shape (joints,).

    Attributes:
        is_active: whether it adds anything.
        stiffness_nm_rad: k_p.
        damping_nm_s: k_d.
    """

    is_active: bool
    stiffness_nm_rad: Vector
    damping_nm_s: Vector


def no_drive_feedback(joints: int) -> DriveGains:
    """A drive that follows torques alone."""
    return DriveGains(False, np.zeros(joints), np.zeros(joints))


def critically_damped(inertia_kg_m2: Vector, bandwidth_rad_s: float) -> DriveGains:
    """k_p = I ω² and k_d = 2 I ω for joints that feel these inertias, shape (joints,)."""
    stiffness = inertia_kg_m2 * bandwidth_rad_s**2
    return DriveGains(True, stiffness, 2.0 * inertia_kg_m2 * bandwidth_rad_s)


@compiled
def drive_torque(
    target: float, target_velocity: float, position: float, velocity: float, gains: DriveGains,
    joint: int,
) -> float:  # fmt: skip
    """k_p (q* − q) + k_d (v* − q̇) of a joint, N m; positions in rad, velocities in rad/s."""
    stiffness: float = gains.stiffness_nm_rad[joint]
    damping: float = gains.damping_nm_s[joint]
    return stiffness * (target - position) + damping * (target_velocity - velocity)

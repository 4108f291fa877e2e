"""Joint friction: Coulomb, Stribeck and viscous."""

from __future__ import annotations

import math

import numpy as np

from bus_schema.arrays import Matrix
from bus_schema.configuration import expand
from bus_schema.runtime.compiled import compiled
from plant_emulator.configuration import FrictionConfiguration

PARAMETERS = (
    "coulomb_nm",
    "viscous_nm_s",
    "stribeck_nm",
    "stribeck_velocity_rad_s",
    "smoothing_velocity_rad_s",
)
"""Rows of a friction table."""


def friction_table(configuration: FrictionConfiguration, joints: int) -> Matrix:
    """Friction parameters per joint, shape (parameters, joints)."""
    table = np.array(
        [
            expand(getattr(configuration, name), joints, f"plant.friction.{name}")
            for name in PARAMETERS
        ]
    )
    if not configuration.enabled:
        table[:3] = 0.0
    return table


@compiled
def friction_torque(velocity: float, table: Matrix, joint: int) -> float:
    """Torque against the motion of one joint, N m."""
    stribeck = velocity / table[3, joint]
    dry = table[0, joint] + table[2, joint] * math.exp(-stribeck * stribeck)
    smooth_sign = math.tanh(velocity / table[4, joint])
    return float(dry * smooth_sign + table[1, joint] * velocity)

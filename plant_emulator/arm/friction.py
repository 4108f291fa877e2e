"""Joint friction: Coulomb, Stribeck and viscous."""

from __future__ import annotations

import math

import numpy as np

from bus_schema.arrays import Records, records
from bus_schema.configuration import expand
from bus_schema.runtime.compiled import compiled
from plant_emulator.configuration import FrictionConfiguration


def friction_table(configuration: FrictionConfiguration, joints: int) -> Records:
    """Friction parameters, named as in section ``plant.friction``, shape (joints,)."""
    columns = {
        name: expand(getattr(configuration, name), joints, f"plant.friction.{name}")
        for name in FrictionConfiguration.model_fields
        if name != "enabled"
    }
    if not configuration.enabled:
        columns |= dict.fromkeys(("coulomb_nm", "viscous_nm_s", "stribeck_nm"), np.zeros(joints))
    return records(joints, columns)


@compiled
def friction_torque(velocity: float, parameters: Records, joint: int) -> float:
    """Torque against the motion of one joint, N m."""
    p = parameters[joint]
    stribeck = velocity / p.stribeck_velocity_rad_s
    dry = p.coulomb_nm + p.stribeck_nm * math.exp(-stribeck * stribeck)
    smooth_sign = math.tanh(velocity / p.smoothing_velocity_rad_s)
    return float(dry * smooth_sign + p.viscous_nm_s * velocity)

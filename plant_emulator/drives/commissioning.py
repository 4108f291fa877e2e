"""Which drives a robot has: its scenario's, commissioned for its joints."""

from __future__ import annotations

import math

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.can_configuration import CanConfiguration
from bus_schema.configuration import ConfigurationError, expand
from bus_schema.robot_description import RobotDescription
from plant_emulator.configuration import PlantConfiguration
from plant_emulator.drives.bank import DriveBank
from plant_emulator.drives.cansimple.cansimple_drive import CanSimpleDrive
from plant_emulator.drives.cia402.cia402_drive import Cia402Drive
from plant_emulator.drives.drive import Drive, DriveSettings, Send

PROTOCOLS: dict[str, type[Drive]] = {"cia402": Cia402Drive, "cansimple": CanSimpleDrive}

PEAK_TO_RATED = 32.0
"""Effort limit to rated torque by default: the limit is 32000 ‰, nearly all that 16 bits hold."""

_LARGEST_PER_MILLE = 32_767


def commission(
    can: CanConfiguration, robot: RobotDescription, plant: PlantConfiguration
) -> tuple[DriveSettings, ...]:
    """Settings of the drive of each joint.

    Raises:
        ConfigurationError: a value does not fit the robot.
    """
    damping = expand(plant.stop_damping_nm_s, robot.joints, "plant.stop_damping_nm_s")
    rated = _rated_torque_nm(can, robot)
    return tuple(
        DriveSettings(
            node_id=node_id,
            rated_torque_nm=float(rated[joint]),
            max_torque_nm=_max_torque_nm(float(robot.effort_limits_nm[joint]), float(rated[joint])),
            counts_per_turn=can.counts_per_turn,
            lower_rad=float(robot.lower_rad[joint]),
            upper_rad=float(robot.upper_rad[joint]),
            stop_damping_nm_s=float(damping[joint]),
            watchdog_ms=can.command_timeout_ms,
        )
        for joint, node_id in enumerate(can.node_ids_of(robot.joints))
    )


def build_bank(
    can: CanConfiguration, robot: RobotDescription, plant: PlantConfiguration, send: Send
) -> DriveBank:
    """The drives of a robot.

    Raises:
        ConfigurationError: a value does not fit the robot.
    """
    return DriveBank(PROTOCOLS[can.protocol], commission(can, robot, plant), send)


def _rated_torque_nm(can: CanConfiguration, robot: RobotDescription) -> Vector:
    if can.rated_torque_nm is not None:
        return expand(can.rated_torque_nm, robot.joints, "link.can.rated_torque_nm")
    for name, limit in zip(robot.joint_names, robot.effort_limits_nm, strict=True):
        if not math.isfinite(limit):
            allowed = f"must be given: the URDF has no effort limit for joint {name}"
            raise ConfigurationError("link.can.rated_torque_nm", None, allowed)
    return np.asarray(robot.effort_limits_nm / PEAK_TO_RATED)


def _max_torque_nm(effort_limit_nm: float, rated_nm: float) -> float:
    """The joint's limit, or what a 16-bit torque can say if that is less."""
    return min(effort_limit_nm, rated_nm * _LARGEST_PER_MILLE / 1000.0)

"""Builds the drives of a scenario, commissioned for the robot's joints."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from bus_schema.can.protocol import PROTOCOLS
from bus_schema.configuration import ConfigurationError, expand
from bus_schema.drive_feedback import DriveGains
from bus_schema.link.can_configuration import CanConfiguration
from bus_schema.registry import Registry
from bus_schema.robot_description import RobotDescription
from plant_emulator.configuration import PlantConfiguration
from plant_emulator.drives.bank import DriveBank
from plant_emulator.drives.cascade import UNTUNED, CascadeGains
from plant_emulator.drives.drive import Drive, DriveSettings, Send

DRIVES: Registry[type[Drive[Any]]] = Registry(
    "drives",
    "link.can.protocol",
    Drive,
    {
        "cia402": "plant_emulator.drives.cia402.drive:Cia402Drive",
        "cansimple": "plant_emulator.drives.cansimple.drive:CanSimpleDrive",
        "mit": "plant_emulator.drives.mit.drive:MitDrive",
        "damiao": "plant_emulator.drives.damiao.drive:DamiaoDrive",
        "moteus": "plant_emulator.drives.moteus.drive:MoteusDrive",
    },
)
"""The drives of each protocol of `bus_schema.can.protocol.PROTOCOLS`."""


def drive_of(protocol: str) -> type[Drive[Any]]:
    """Return the class of a protocol's drives.

    Raises:
        ConfigurationError: the package of the protocol has none, or they cannot be loaded.
    """
    if protocol in PROTOCOLS and protocol not in DRIVES:
        owner = PROTOCOLS.extension(protocol)
        allowed = f"{owner} has no drives: its package must add {protocol} to funnel_hil.drives too"
        raise ConfigurationError(DRIVES.key, protocol, allowed)
    return DRIVES[protocol]


def commission(
    can: CanConfiguration,
    robot: RobotDescription,
    plant: PlantConfiguration,
    tuned: DriveGains | None = None,
) -> tuple[DriveSettings[Any], ...]:
    """Return the settings of each joint's drive; arguments as for `build_bank`.

    Raises:
        ConfigurationError: a value does not fit the robot.
    """
    damping = expand(plant.stop_damping_nm_s, robot.joints, "plant.stop_damping_nm_s")
    protocol = PROTOCOLS[can.protocol]()
    largest = protocol.largest_torques_nm(can, robot)
    node_ids = protocol.node_ids(can, robot.joints)
    own = protocol.own_settings(can, robot)
    return tuple(
        DriveSettings(
            node_id=node_id,
            max_torque_nm=float(largest[joint]),
            max_velocity_rad_s=float(robot.velocity_limits_rad_s[joint]),
            counts_per_turn=can.counts_per_turn,
            lower_rad=float(robot.lower_rad[joint]),
            upper_rad=float(robot.upper_rad[joint]),
            stop_damping_nm_s=float(damping[joint]),
            watchdog_ms=can.command_timeout_ms,
            fd_process_data=can.fd_process_data,
            own=own[joint],
            gains=UNTUNED if tuned is None else _cascade(tuned, joint),
        )
        for joint, node_id in enumerate(node_ids)
    )


def _cascade(tuned: DriveGains, joint: int) -> CascadeGains:
    """A position loop around a velocity loop that has this stiffness and damping."""
    stiffness, damping = float(tuned.stiffness_nm_rad[joint]), float(tuned.damping_nm_s[joint])
    return CascadeGains(stiffness / damping if damping else 0.0, damping)


def build_bank(
    can: CanConfiguration,
    robot: RobotDescription,
    plant: PlantConfiguration,
    send: Send,
    *,
    polled: bool = False,
    tuned: DriveGains | None = None,
) -> DriveBank:
    """The drives of a robot.

    Args:
        can: section ``link.can`` of the scenario.
        robot: the robot.
        plant: section ``plant``.
        send: takes the frames that the drives send.
        polled: as the closed loop wants them: estimates only when asked for, watchdog on. Else
            they are as real ones are delivered, with no watchdog unless ``command_timeout_ms`` is
            given; see `DriveSettings`.
        tuned: stiffness and damping to which drives with loops of their own are tuned.

    Raises:
        ConfigurationError: a value does not fit the robot.
    """
    settings = commission(can, robot, plant, tuned)
    if polled:
        settings = tuple(replace(each, is_polled=True) for each in settings)
    elif "command_timeout_ms" not in can.model_fields_set:
        settings = tuple(replace(each, watchdog_ms=0.0) for each in settings)
    return DriveBank(drive_of(can.protocol), settings, send)

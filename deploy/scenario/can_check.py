"""Whether a scenario with ``link.kind: can`` fits together, whatever the machine has."""

from __future__ import annotations

import canopen

from bus_schema.can.can_run import CanRun
from bus_schema.can.codec import build_codec
from bus_schema.configuration import ConfigurationError
from bus_schema.robot_description import RobotDescription
from plant_emulator.configuration import PlantConfiguration
from plant_emulator.drives.commissioning import commission
from plant_emulator.drives.fault_plan import parse_fault

_NEEDED = (
    0x1000, 0x1016, 0x1017, 0x1400, 0x6040, 0x6041, 0x6060, 0x6061, 0x6064, 0x606C, 0x6071, 0x6076,
    0x608F, 0x6502,
)  # fmt: skip


def check_can_link(run: CanRun, robot: RobotDescription, plant: PlantConfiguration) -> None:
    """Check bus, drives and faults of a scenario.

    Raises:
        ConfigurationError: something does not fit.
    """
    can = run.link.can
    node_ids = can.node_ids_of(robot.joints)
    run.check()
    build_codec(can, robot)
    commission(can, robot, plant)
    for text in can.faults.drives:
        try:
            parse_fault(text, node_ids)
        except ConfigurationError as error:
            raise ConfigurationError("link.can.faults.drives", text, error.allowed) from error
    if can.eds is not None:
        _check_eds(can.eds)


def _check_eds(path: str) -> None:
    try:
        dictionary = canopen.import_od(path, 1)
    except Exception as error:  # the parser raises whatever comes its way
        raise ConfigurationError(
            "link.can.eds", path, f"must be a file that is an EDS of a CiA 402 drive: {error}"
        ) from error
    lacking = [f"0x{index:04X}" for index in _NEEDED if index not in dictionary]
    if lacking:
        raise ConfigurationError(
            "link.can.eds", path, f"must describe a CiA 402 drive; it lacks {', '.join(lacking)}"
        )

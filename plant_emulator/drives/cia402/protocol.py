"""CiA 402 on CANopen, as one of the protocols of motor drives."""

from __future__ import annotations

from pathlib import Path

import canopen
from canopen.objectdictionary import ODVariable

from bus_schema.can.cia402.codec import Cia402Codec, rated_torque_nm
from bus_schema.can.cia402.master import Cia402Master
from bus_schema.can.frame import CanBus
from bus_schema.can.position.cia402 import (
    Cia402PositionCodec,
    Cia402PositionMaster,
    loop_gains,
)
from bus_schema.configuration import ConfigurationError
from bus_schema.drive_feedback import DriveGains
from bus_schema.link.can_configuration import CanConfiguration
from bus_schema.robot_description import RobotDescription
from bus_schema.user_files import read_bytes
from plant_emulator.drives.cia402.cia402_drive import Cia402Drive
from plant_emulator.drives.protocol import DriveProtocol

_NEEDED = (
    0x1000, 0x1016, 0x1017, 0x1400, 0x6040, 0x6041, 0x6060, 0x6061, 0x6064, 0x606C, 0x6071, 0x6076,
    0x608F, 0x6502,
)  # fmt: skip
"""Objects that a master must find in the description of a drive."""


class Cia402Protocol(DriveProtocol):
    """CiA 402 in cyclic synchronous torque mode; with targets, in position mode."""

    title = "CiA 402"
    takes_targets = True
    has_fd_process_data = True
    drive = Cia402Drive
    drive_master = Cia402Master

    def codec(self, can: CanConfiguration, robot: RobotDescription) -> Cia402Codec:
        node_ids = self.node_ids(can, robot.joints)
        rated_nm = rated_torque_nm(can, robot)
        return Cia402Codec(node_ids, can.counts_per_turn, rated_nm, is_fd=can.fd_process_data)

    def target_codec(
        self, can: CanConfiguration, robot: RobotDescription, gains: DriveGains
    ) -> Cia402PositionCodec:
        loop_gains(gains)
        node_ids = self.node_ids(can, robot.joints)
        rated_nm = rated_torque_nm(can, robot)
        is_fd = can.fd_process_data
        return Cia402PositionCodec(node_ids, can.counts_per_turn, rated_nm, is_fd=is_fd)

    def target_master(
        self, bus: CanBus, can: CanConfiguration, robot: RobotDescription, gains: DriveGains
    ) -> Cia402PositionMaster:
        codec = self.target_codec(can, robot, gains)
        return Cia402PositionMaster(bus, can, self.node_ids(can, robot.joints), codec, gains)

    def check(self, can: CanConfiguration) -> None:
        if can.eds is None:
            return
        try:
            read_bytes(Path(can.eds))
            dictionary = canopen.import_od(can.eds, 1)
            for each in dictionary.values():
                for variable in (each,) if isinstance(each, ODVariable) else each.values():
                    if (variable.data_type or 1) < 1:
                        raise ValueError(f"{variable.name} has data type {variable.data_type}")
        except Exception as error:  # the parser raises whatever comes its way
            allowed = f"must be a file that is an EDS of a CiA 402 drive: {error}"
            raise ConfigurationError("link.can.eds", can.eds, allowed) from error
        lacking = [f"0x{index:04X}" for index in _NEEDED if index not in dictionary]
        if lacking:
            allowed = f"must describe a CiA 402 drive; it lacks {', '.join(lacking)}"
            raise ConfigurationError("link.can.eds", can.eds, allowed)

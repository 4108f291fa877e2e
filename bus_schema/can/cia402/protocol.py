"""CiA 402 on CANopen, as one of the protocols of motor drives."""

from __future__ import annotations

from bus_schema.can.cia402.canopen_adapter import check_eds
from bus_schema.can.cia402.codec import Cia402Codec, rated_torque_nm
from bus_schema.can.cia402.master import Cia402Master
from bus_schema.can.protocol import DriveProtocol
from bus_schema.drive_feedback import DriveGains
from bus_schema.link.can_configuration import CanConfiguration
from bus_schema.robot_description import RobotDescription


class Cia402Protocol(DriveProtocol):
    """CiA 402 in cyclic synchronous torque mode; with gains, in position mode."""

    title = "CiA 402"
    takes_targets = True
    has_fd_process_data = True
    master = Cia402Master

    def codec(
        self, can: CanConfiguration, robot: RobotDescription, gains: DriveGains | None = None
    ) -> Cia402Codec:
        node_ids = self.node_ids(can, robot.joints)
        rated_nm, is_fd = rated_torque_nm(can, robot), can.fd_process_data
        return Cia402Codec(node_ids, can.counts_per_turn, rated_nm, gains=gains, is_fd=is_fd)

    def check(self, can: CanConfiguration) -> None:
        if can.eds is not None:
            check_eds(can.eds)

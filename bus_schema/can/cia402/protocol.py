"""CiA 402 on CANopen, as one of the protocols of motor drives."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.can.cia402.canopen_adapter import check_eds
from bus_schema.can.cia402.codec import Cia402Codec, Cia402Settings, rated_torque_nm
from bus_schema.can.cia402.master import Cia402Master
from bus_schema.can.frame import CanFrame, is_data
from bus_schema.can.protocol import DriveProtocol
from bus_schema.drive_feedback import DriveGains
from bus_schema.link.can_configuration import CanConfiguration
from bus_schema.robot_description import RobotDescription

_MOST_PER_MILLE = 32_767
_SDO = struct.Struct("<BHBI")
_UPLOAD, _TO_NODE, _FROM_NODE = 0x40, 0x600, 0x580
_ASKED = {
    (0x6076, 0): "rated torque in mN m (0x6076)",
    (0x608F, 1): "encoder increments per turn (0x608F)",
}


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

    def questions(self, can: CanConfiguration, node_id: int) -> Sequence[CanFrame]:  # noqa: ARG002
        uploads = (_SDO.pack(_UPLOAD, index, subindex, 0) for index, subindex in _ASKED)
        return [CanFrame(_TO_NODE + node_id, each) for each in uploads]

    def answer(self, frame: CanFrame) -> tuple[int, str, float] | None:
        node_id = frame.identifier - _FROM_NODE
        if not (0 < node_id <= self.largest_node_id and is_data(frame, _SDO.size)):
            return None
        _, index, subindex, value = _SDO.unpack(frame.data)  # a drive that aborts is there, too
        name = _ASKED.get((index, subindex))
        return None if name is None else (node_id, name, value)

    def expected_answers(
        self, can: CanConfiguration, robot: RobotDescription
    ) -> Sequence[Mapping[str, float]]:
        rated, turn = _ASKED.values()
        torques_mnm = self.codec(can, robot).rated_mnm.tolist()
        return [{rated: torque_mnm, turn: can.counts_per_turn} for torque_mnm in torques_mnm]

    def largest_torques_nm(self, can: CanConfiguration, robot: RobotDescription) -> Vector:
        most_nm = rated_torque_nm(can, robot) * _MOST_PER_MILLE / 1000.0  # of 16 bits
        return np.asarray(np.minimum(robot.effort_limits_nm, most_nm))

    def own_settings(
        self, can: CanConfiguration, robot: RobotDescription
    ) -> tuple[Cia402Settings, ...]:
        return tuple(map(Cia402Settings, rated_torque_nm(can, robot).tolist()))

    def check(self, can: CanConfiguration, *, takes_targets: bool) -> None:
        if can.eds is not None:
            check_eds(can.eds, takes_targets=takes_targets)

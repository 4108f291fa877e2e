"""Damiao motors, as one of the protocols of motor drives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from bus_schema.can.damiao.codec import DamiaoCodec, Mode
from bus_schema.can.damiao.master import DamiaoMaster
from bus_schema.can.damiao.motors import MOTORS, DamiaoMotor
from bus_schema.can.damiao.registers import (
    RANGES,
    REGISTER_IDENTIFIER,
    Register,
    RegisterFrame,
    Request,
    register_frame,
)
from bus_schema.can.frame import CanFrame, is_data
from bus_schema.can.mit.codec import COMMAND_BYTES, MitRanges
from bus_schema.can.mit.protocol import MitProtocol
from bus_schema.configuration import ConfigurationError
from bus_schema.drive_feedback import DriveGains
from bus_schema.link.can_configuration import CanConfiguration
from bus_schema.robot_description import RobotDescription

_FEEDBACK_OFFSET = 0x10


class DamiaoSettings(NamedTuple):
    """What both sides must agree on of one motor.

    Attributes:
        motor: its kind.
        feedback_id: identifier of its frames.
    """

    motor: DamiaoMotor = MOTORS["DM4310"]
    feedback_id: int = _FEEDBACK_OFFSET + 1


class DamiaoProtocol(MitProtocol):
    """MIT mode, three others, registers, and feedback at an identifier of each motor's own."""

    title = "Damiao"
    has_fd_process_data = True
    range_key = "{name} of link.can.damiao.motor"
    master = DamiaoMaster

    def codec(
        self, can: CanConfiguration, robot: RobotDescription, gains: DriveGains | None = None
    ) -> DamiaoCodec:
        ranges = self.ranges(can, robot.joints)
        self._check_gains(gains, ranges)
        node_ids, feedback_ids = self.node_ids(can, robot.joints), _feedback_ids(can, robot.joints)
        is_fd = can.fd_process_data
        return DamiaoCodec(node_ids, ranges, feedback_ids, is_fd=is_fd, gains=gains)

    def ranges(self, can: CanConfiguration, joints: int) -> tuple[MitRanges, ...]:
        return tuple(each.motor.ranges for each in self.own_settings(can, joints))

    def node_ids(self, can: CanConfiguration, joints: int) -> tuple[int, ...]:
        node_ids = can.node_ids_of(joints)
        taken = {node_id + mode.offset for node_id in node_ids for mode in Mode}
        feedback_ids = _feedback_ids(can, joints)
        if twice := sorted({*taken, REGISTER_IDENTIFIER} & {*feedback_ids}):
            raise ConfigurationError(
                "link.can.damiao.feedback_ids", list(feedback_ids),
                "must differ from the identifiers of commands (the addresses, those plus"
                f" 0x100, 0x200 and 0x300, and 0x7FF); {twice} do not", ["link.can.node_ids"],
            )  # fmt: skip
        return node_ids

    def questions(self, can: CanConfiguration, node_id: int) -> Sequence[CanFrame]:
        asked = (RegisterFrame(node_id, Request.READ, register).packed() for register in RANGES)
        return [CanFrame(REGISTER_IDENTIFIER, each, is_fd=can.fd_process_data) for each in asked]

    def answer(self, frame: CanFrame) -> tuple[int, str, float] | None:
        if not is_data(frame, COMMAND_BYTES, is_fd=frame.is_fd):
            return None
        node_id, request, register, value = register_frame(frame.data)
        is_ours = frame.identifier != REGISTER_IDENTIFIER and request == Request.READ
        return (node_id, Register(register).name, value) if is_ours and register in RANGES else None

    def expected_answers(
        self, can: CanConfiguration, robot: RobotDescription
    ) -> Sequence[Mapping[str, float]]:
        return [
            {register.name: getattr(ranges, name) for register, name in RANGES.items()}
            for ranges in self.ranges(can, robot.joints)
        ]

    def own_settings(self, can: CanConfiguration, joints: int) -> tuple[DamiaoSettings, ...]:
        names = can.damiao.motor
        if len(names) not in (1, joints):
            raise ConfigurationError(
                "link.can.damiao.motor", list(names), f"one, or one for each of the {joints} joints"
            )
        names = names * joints if len(names) == 1 else names
        rows = zip(names, _feedback_ids(can, joints), strict=True)
        return tuple(DamiaoSettings(MOTORS[name], feedback_id) for name, feedback_id in rows)


def _feedback_ids(can: CanConfiguration, joints: int) -> tuple[int, ...]:
    given = can.damiao.feedback_ids
    feedback_ids = given or tuple(_FEEDBACK_OFFSET + each for each in can.node_ids_of(joints))
    if len(feedback_ids) != joints:
        raise ConfigurationError(
            "link.can.damiao.feedback_ids",
            list(feedback_ids),
            f"one for each of the {joints} joints",
        )
    return feedback_ids

"""ODrive's CANSimple, as one of the protocols of motor drives."""

from __future__ import annotations

from collections.abc import Sequence

from bus_schema.can.cansimple.codec import COMMAND_BITS, CanSimpleCodec, Command, identifier
from bus_schema.can.cansimple.master import CanSimpleMaster
from bus_schema.can.frame import CanFrame, is_data
from bus_schema.can.protocol import DriveProtocol
from bus_schema.configuration import ConfigurationError
from bus_schema.drive_feedback import DriveGains
from bus_schema.link.can_configuration import CanConfiguration, CanSimpleConfiguration
from bus_schema.robot_description import RobotDescription

_LARGEST_WORD = 32_767
_BEAT_BYTES = 8


class CanSimpleProtocol(DriveProtocol):
    """CANSimple in torque control; with gains, in position control."""

    title = "CANSimple"
    largest_node_id = 63
    takes_targets = True
    master = CanSimpleMaster

    def codec(
        self, can: CanConfiguration, robot: RobotDescription, gains: DriveGains | None = None
    ) -> CanSimpleCodec:
        if gains is not None:
            _check_position_control(can, robot, gains)
        return CanSimpleCodec(self.node_ids(can, robot.joints), gains, can.cansimple)

    def questions(self, can: CanConfiguration, node_id: int) -> Sequence[CanFrame]:  # noqa: ARG002
        return [CanFrame(identifier(node_id, Command.HEARTBEAT), is_remote=True)]

    def answer(self, frame: CanFrame) -> tuple[int, str, float] | None:
        node_id, command = divmod(frame.identifier, 1 << COMMAND_BITS)
        is_beat = command == Command.HEARTBEAT and is_data(frame, _BEAT_BYTES)
        return (node_id, "heartbeat", 1.0) if is_beat and node_id else None

    def own_settings(
        self, can: CanConfiguration, joints: int
    ) -> tuple[CanSimpleConfiguration, ...]:
        return (can.cansimple,) * joints


def _check_position_control(
    can: CanConfiguration, robot: RobotDescription, gains: DriveGains
) -> None:
    scale = can.cansimple.input_torque_scale
    most_nm = float(robot.effort_limits_nm.max())
    if most_nm * scale > _LARGEST_WORD:
        raise ConfigurationError(
            "link.can.cansimple.input_torque_scale", scale,
            f"must be at most {_LARGEST_WORD / most_nm:.4g} for the torque feed-forward of"
            f" {most_nm:g} N m to go with a position, which has 16 bits for it",
        )  # fmt: skip
    if not (gains.damping_nm_s > 0.0).all():
        raise ConfigurationError(
            "plant.drive_feedback.damping_nm_s", gains.damping_nm_s.tolist(),
            "must be more than 0 with CANSimple: the position loop is around the velocity loop",
        )  # fmt: skip

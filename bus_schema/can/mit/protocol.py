"""The MIT mini-cheetah's protocol: its settings in a scenario, and the master of its drives."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from bus_schema.arrays import Vector
from bus_schema.can.frame import CanFrame
from bus_schema.can.mit.codec import MitCodec, MitRanges, Special
from bus_schema.can.protocol import DriveProtocol
from bus_schema.can.request_master import RequestMaster
from bus_schema.configuration import ConfigurationError, expand
from bus_schema.drive_feedback import DriveGains
from bus_schema.link.can_configuration import CanConfiguration
from bus_schema.robot_description import RobotDescription


class MitMaster(RequestMaster):
    """The master; the arguments are those of `CanMaster`.

    It finds drives by disabling motor mode, which also cancels the commands of a former master. The
    first request for states enables it, the first command moves a joint.
    """

    _codec: MitCodec

    def _stop_requests(self) -> Sequence[CanFrame]:
        return self._codec.special_frames(Special.DISABLE)


class MitSettings(NamedTuple):
    """Settings of one drive that both sides must share.

    Attributes:
        ranges: of the numbers in its frames.
        reply_identifier: identifier of its replies.
        reply_bytes: 8 with temperature and error, 6 without.
    """

    ranges: MitRanges = MitRanges()
    reply_identifier: int = 0
    reply_bytes: int = 8


class MitProtocol(DriveProtocol):
    """Position, velocity, stiffness, damping and torque in one frame.

    Attributes:
        range_key: what says how large numbers in frames can be.
    """

    title = "MIT"
    range_key = "link.can.mit.{name}"
    takes_targets = True
    answers_torques = True
    master = MitMaster

    def codec(
        self, can: CanConfiguration, robot: RobotDescription, gains: DriveGains | None = None
    ) -> MitCodec:
        node_ids, ranges = self.node_ids(can, robot.joints), self.ranges(can, robot.joints)
        self._check_gains(gains, ranges)
        return MitCodec(node_ids, ranges, can.mit.reply_identifier, can.mit.reply_bytes, gains)

    def ranges(self, can: CanConfiguration, joints: int) -> tuple[MitRanges, ...]:
        """The ranges of each joint's drive.

        Raises:
            ConfigurationError: there are not as many as joints.
        """
        columns = [
            expand(getattr(can.mit, name), joints, f"link.can.mit.{name}").tolist()
            for name in MitRanges._fields
        ]
        return tuple(MitRanges(*row) for row in zip(*columns, strict=True))

    def node_ids(self, can: CanConfiguration, joints: int) -> tuple[int, ...]:
        node_ids = super().node_ids(can, joints)
        if can.mit.reply_identifier in node_ids:
            raise ConfigurationError(
                "link.can.mit.reply_identifier", can.mit.reply_identifier,
                "must differ from the drives' addresses",
            )  # fmt: skip
        return node_ids

    def own_settings(self, can: CanConfiguration, robot: RobotDescription) -> tuple[Any, ...]:
        mit = can.mit
        return tuple(
            MitSettings(ranges, mit.reply_identifier, mit.reply_bytes)
            for ranges in self.ranges(can, robot.joints)
        )

    def warnings(
        self, can: CanConfiguration, robot: RobotDescription, most_nm: Vector
    ) -> list[str]:
        rows = zip(robot.joint_names, self.ranges(can, robot.joints), most_nm.tolist(), strict=True)
        cut_off = [
            f"{name} ({most:g} N m, cut off at {ranges.torque_nm:g})"
            for name, ranges, most in rows
            if most > ranges.torque_nm
        ]
        if not cut_off:
            return []
        key = self.range_key.format(name="torque_nm")
        return [
            f"frames of {self.title} drives cannot represent all torques of {', '.join(cut_off)}:"
            f" set {key} to the range of the drives, or limits.torque_nm to the available torque"
        ]

    def _check_gains(self, gains: DriveGains | None, ranges: tuple[MitRanges, ...]) -> None:
        for name in ("stiffness_nm_rad", "damping_nm_s") if gains is not None else ():
            wanted = getattr(gains, name)
            most = [getattr(each, name) for each in ranges]
            if (wanted > most).any():
                key = self.range_key.format(name=name)
                raise ConfigurationError(
                    f"plant.drive_feedback.{name}", wanted.tolist(),
                    f"must be within the range of a frame, {key} = {most}",
                )  # fmt: skip

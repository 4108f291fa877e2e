"""The MIT mini-cheetah's protocol: its settings in a scenario, and the master of its drives."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

from bus_schema.arrays import Vector
from bus_schema.can.frame import CanBus, CanFrame
from bus_schema.can.master import POLL_S, CanMaster, DriveError
from bus_schema.can.mit.codec import MitCodec, MitRanges, RequestCodec, Special
from bus_schema.can.protocol import DriveProtocol
from bus_schema.configuration import ConfigurationError, expand
from bus_schema.drive_feedback import DriveGains
from bus_schema.link.can_configuration import CanConfiguration
from bus_schema.robot_description import RobotDescription

_QUIET_S, _LONGEST_QUIET_S = 0.1, 1.0


class MitMaster(CanMaster):
    """The master; the arguments are those of `CanMaster`.

    Drives are found by leaving motor mode, which also cancels the commands of a former master;
    the first request for states enters it, the first command moves a joint.

    Nothing in a reply says which frame it answers, but a drive answers in turn: the master counts
    the commands that each drive has yet to reply to. Only replies to requests are states.
    """

    _codec: RequestCodec

    def __init__(
        self, bus: CanBus, can: CanConfiguration, node_ids: tuple[int, ...], codec: RequestCodec
    ) -> None:
        super().__init__(bus, can, node_ids, codec)
        self._owed = [0] * len(node_ids)
        self._errors = [0] * len(node_ids)
        self._is_leaving = False

    def enable(self, timeout_s: float, is_stop_requested: Callable[[], bool]) -> bool:
        if not self._await_drives(timeout_s, is_stop_requested):
            return False
        self._await_quiet()
        if errors := self._missed_heartbeats():
            raise DriveError("; ".join(errors))
        self._is_powered = [True] * len(self._node_ids)
        return True

    def _only_master_sends(self, frame: CanFrame) -> str | None:
        is_command = frame.identifier in self._joint_of and not frame.is_remote
        return "commands" if is_command and self._codec.reply(frame) is None else None

    def sample(self, now_ns: int) -> None:
        if self._awaited:  # a reply was lost, and those that come would be taken for one another
            self._settle()
        if not self._is_stopping:
            super().sample(now_ns)
            return
        self._now_ns, self._is_leaving = now_ns, True
        self._awaited = set(self._joint_of.values()) - self._silent
        self._send(self._codec.special_frames(Special.DISABLE))

    def read(self, timeout_s: float, position: Vector, velocity: Vector) -> bool:
        is_complete = super().read(timeout_s, position, velocity)
        if self._is_leaving:
            for joint in set(self._joint_of.values()) - self._awaited:
                self._is_powered[joint] = False
        return is_complete

    def command(self, torque_nm: Vector) -> None:
        self._owed = [owed + 1 for owed in self._owed]
        super().command(torque_nm)

    def leave(self) -> None:
        self._send(self._codec.special_frames(Special.DISABLE))

    def _ask(self) -> None:
        frames = self._codec.special_frames(Special.DISABLE)
        self._send(frames[joint] for joint in sorted(self._absent))

    def _listen(self) -> None:
        self._absent -= {self._next_answering(POLL_S)}

    def _await_quiet(self) -> None:
        """Let all replies come to what had to be said more than once."""
        began_s = quiet_since_s = time.monotonic()
        while time.monotonic() < min(quiet_since_s + _QUIET_S, began_s + _LONGEST_QUIET_S):
            if self._next_answering(POLL_S) is not None:
                quiet_since_s = time.monotonic()

    def _next_answering(self, timeout_s: float) -> int | None:
        """The joint whose drive replies with the next frame; None if it is no reply."""
        frame = self._bus.receive(timeout_s)
        return None if frame is None else self._note_answer(frame)

    def _note_answer(self, frame: CanFrame) -> int | None:
        """Note a frame outside the loop: a reply, whose joint is returned, or a stranger's."""
        joint = self._note_reply(frame)
        if joint is None:
            self._note_stranger(frame)
        return joint

    def _note_reply(self, frame: CanFrame) -> int | None:
        """Note the error in a reply; its joint, None for any other frame."""
        found = self._codec.reply(frame)
        if found is None:
            return None
        joint, reply = found
        self._errors[joint] = reply.error
        return joint

    def _take_in(self, frame: CanFrame, position: Vector, velocity: Vector) -> int | None:
        joint = self._note_reply(frame)
        if joint is not None and self._owed[joint]:
            self._owed[joint] -= 1
            return None
        return super()._take_in(frame, position, velocity)

    def _settle(self) -> None:
        """Drop what has come, and wait for no reply to a command that was sent before."""
        while (frame := self._bus.receive(0.0)) is not None:
            self._note_answer(frame)
        self._owed = [0] * len(self._owed)

    def _missed_heartbeats(self) -> list[str]:
        """Errors that replies report; there are no heartbeats."""
        return [
            f"drive {node_id}: error {error}"
            for node_id, error in zip(self._node_ids, self._errors, strict=True)
            if error
        ]


class MitSettings(NamedTuple):
    """What both sides must agree on of one drive.

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

    def own_settings(self, can: CanConfiguration, joints: int) -> tuple[object, ...]:
        mit = can.mit
        return tuple(
            MitSettings(ranges, mit.reply_identifier, mit.reply_bytes)
            for ranges in self.ranges(can, joints)
        )

    def oddities(
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

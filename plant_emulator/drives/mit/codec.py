"""Cyclic frames of the MIT protocol.

Whatever a drive is sent, it replies with its state. A cycle is, for each drive, the frame that
enters motor mode, which the AK manual has as the way to ask for the state; the reply; the command;
and the reply to that, of which nobody makes use.
"""

from __future__ import annotations

from collections.abc import Sequence

from bus_schema.arrays import Matrix, Vector
from bus_schema.can.frame import CanFrame
from bus_schema.can.frame_timing import CycleFrames
from bus_schema.drive_feedback import DriveGains
from plant_emulator.drives.mit.wire import (
    Command,
    MitRanges,
    Reply,
    Special,
    command_of,
    is_command,
    is_reply,
    packed_command,
    reply_of,
    special,
    special_of,
)


class MitCodec:
    """Frames of one control cycle, see `TargetCodec`.

    Args:
        node_ids: addresses of the drives, one for each joint.
        ranges: of the numbers of each drive.
        reply_identifier: identifier of all replies.
        reply_bytes: bytes of a reply.
    """

    def __init__(
        self,
        node_ids: Sequence[int],
        ranges: Sequence[MitRanges],
        reply_identifier: int,
        reply_bytes: int,
    ) -> None:
        self._node_ids, self._ranges = tuple(node_ids), tuple(ranges)
        self._joint_of = {node_id: joint for joint, node_id in enumerate(node_ids)}
        self._reply_identifier = reply_identifier
        self._sampling = self.special_frames(Special.ENTER)
        self.cycle = CycleFrames(
            (), (8, reply_bytes, 8, reply_bytes),
            f"{{n}} × (request 8 bytes + command 8 bytes + 2 replies of {reply_bytes} bytes)",
        )  # fmt: skip

    def sampling_frames(self) -> Sequence[CanFrame]:
        return self._sampling

    def special_frames(self, kind: Special) -> Sequence[CanFrame]:
        """A special frame to each drive."""
        return [CanFrame(node_id, special(kind)) for node_id in self._node_ids]

    def is_sampling(self, frame: CanFrame) -> bool:
        return frame in self._sampling

    def reply(self, frame: CanFrame) -> tuple[int, Reply] | None:
        """Joint and content of a reply, None for any other frame."""
        if frame.identifier != self._reply_identifier or not is_reply(frame):
            return None
        joint = self._joint_of.get(frame.data[0])
        return None if joint is None else (joint, reply_of(frame.data, self._ranges[joint]))

    def read_state(self, frame: CanFrame, position: Vector, velocity: Vector) -> int | None:
        found = self.reply(frame)
        if found is None:
            return None
        joint, reply = found
        position[joint], velocity[joint] = reply.position_rad, reply.velocity_rad_s
        return joint

    def torque_frames(self, torque_nm: Vector) -> Sequence[CanFrame]:
        return [
            CanFrame(node_id, packed_command(Command(torque_nm=torque), ranges))
            for node_id, torque, ranges in zip(
                self._node_ids, torque_nm.tolist(), self._ranges, strict=True
            )
        ]

    def command_frames(
        self, torque_nm: Vector, target: Matrix, gains: DriveGains
    ) -> Sequence[CanFrame]:
        rows = zip(
            *target.tolist(), gains.stiffness_nm_rad.tolist(), gains.damping_nm_s.tolist(),
            torque_nm.tolist(), strict=True,
        )  # fmt: skip
        return [
            CanFrame(node_id, packed_command(Command(*row), ranges))
            for node_id, row, ranges in zip(self._node_ids, rows, self._ranges, strict=True)
        ]

    def read_torque(self, frame: CanFrame, torque_nm: Vector) -> int | None:
        joint = self._joint_of.get(frame.identifier)
        if joint is None or not is_command(frame) or special_of(frame.data) is not None:
            return None
        torque_nm[joint] = command_of(frame.data, self._ranges[joint]).torque_nm
        return joint

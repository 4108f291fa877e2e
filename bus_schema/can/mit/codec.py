"""Frames of the MIT protocol, as mini-cheetah's public firmware and CubeMars' AK manual have them.

A number is an unsigned integer of 16 or 12 bits over a range that both sides must agree on. It is
cut off, not rounded, as the firmware does: what arrives is up to one step lower than what was sent,
and zero itself is no step of a range around it.

A drive replies with its state to every frame. A cycle is, for each drive, the frame that enters
motor mode, which the AK manual has as the way to ask for the state; the reply; the command; and the
reply to that, which is not used.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

from bus_schema.arrays import Matrix, Vector
from bus_schema.can.codec import AxisState, CanCodec
from bus_schema.can.frame import CanFrame, is_data
from bus_schema.can.frame_timing import CycleFrames
from bus_schema.drive_feedback import DriveGains

_SPECIAL = b"\xff" * 7
COMMAND_BYTES = 8
REPLY_BYTES = (6, 8)
"""Without and with temperature and error."""

_COLDEST_C = -40
_BYTE = 0xFF


class Special(IntEnum):
    """Last byte of the frames FF … FF xx that are no commands."""

    CLEAR_ERROR = 0xFB
    """Damiao motors alone have it."""

    ENABLE = 0xFC
    DISABLE = 0xFD
    ZERO = 0xFE


class MitError(IntEnum):
    """The error byte of a reply, as far as an emulated drive sends it."""

    NONE = 0
    OVER_TEMPERATURE = 1
    OVER_CURRENT = 2
    ENCODER = 5


class MitRanges(NamedTuple):
    """The ranges of one drive's numbers; the first three reach from minus to plus."""

    position_rad: float = 12.5
    velocity_rad_s: float = 50.0
    torque_nm: float = 18.0
    stiffness_nm_rad: float = 500.0
    damping_nm_s: float = 5.0


class MitCommand(NamedTuple):
    """Command of a drive: torque + stiffness (position - q) + damping (velocity - q')."""

    position_rad: float = 0.0
    velocity_rad_s: float = 0.0
    stiffness_nm_rad: float = 0.0
    damping_nm_s: float = 0.0
    torque_nm: float = 0.0


def special(kind: int) -> bytes:
    """Data of a special frame."""
    return _SPECIAL + bytes([kind])


def ending_of(data: bytes) -> int | None:
    """Last byte of eight that look like a special frame, known or not; None for a command."""
    return data[-1] if data[:-1] == _SPECIAL else None


def special_of(data: bytes) -> Special | None:
    """The special frame that eight bytes are; None if there is none like it."""
    return next((kind for kind in Special if kind == ending_of(data)), None)


class _Number(NamedTuple):
    """Encoding of a number.

    Attributes:
        name: attribute of its range, and of what it is part of.
        bits: how many it has.
        is_signed: its range reaches from minus to plus.
    """

    name: str
    bits: int
    is_signed: bool


_POSITION, _VELOCITY = _Number("position_rad", 16, True), _Number("velocity_rad_s", 12, True)
_STIFFNESS, _DAMPING = _Number("stiffness_nm_rad", 12, False), _Number("damping_nm_s", 12, False)
_TORQUE = _Number("torque_nm", 12, True)
_COMMAND = (_POSITION, _VELOCITY, _STIFFNESS, _DAMPING, _TORQUE)
_STATE = (_POSITION, _VELOCITY, _TORQUE)
"""Values in frames, the first one in the highest bits."""


def packed_command(command: MitCommand, ranges: MitRanges) -> bytes:
    """The eight bytes of a command; what is beyond its range is at its end.

    With everything at its upper end it would be a special frame: the velocity is a step lower.
    """
    data = _packed(command, _COMMAND, ranges).to_bytes(COMMAND_BYTES, "big")
    return data if ending_of(data) is None else data[:3] + b"\xef" + data[4:]


def command_of(data: bytes, ranges: MitRanges) -> MitCommand:
    """Return the command in eight bytes that have no `ending_of` a special frame."""
    return MitCommand(*_unpacked(int.from_bytes(data, "big"), _COMMAND, ranges))


def packed_reply(reply: AxisState, ranges: MitRanges, reply_bytes: int) -> bytes:
    """The bytes of a reply, as many as the firmware sends."""
    bits = (reply.node_id & _BYTE) << 40 | _packed(reply, _STATE, ranges)
    rest = bytes([reply.temperature_c - _COLDEST_C, reply.error])
    return (bits.to_bytes(REPLY_BYTES[0], "big") + rest)[:reply_bytes]


def reply_of(data: bytes, ranges: MitRanges) -> AxisState:
    """Return the reply in six or eight bytes."""
    packed = int.from_bytes(data[: REPLY_BYTES[0]], "big")
    position, velocity, torque = _unpacked(packed, _STATE, ranges)
    reply = AxisState(data[0], position, velocity, torque)
    if len(data) == REPLY_BYTES[0]:
        return reply
    return reply._replace(temperature_c=data[6] + _COLDEST_C, error=data[7])


def _packed(values: MitCommand | AxisState, numbers: Sequence[_Number], ranges: MitRanges) -> int:
    packed = 0
    for name, bits, is_signed in numbers:
        value, limit = getattr(values, name), getattr(ranges, name)
        share = (value + limit) / (2.0 * limit) if is_signed else value / limit
        packed = packed << bits | int(min(max(share, 0.0), 1.0) * ((1 << bits) - 1))
    return packed


def _unpacked(packed: int, numbers: Sequence[_Number], ranges: MitRanges) -> list[float]:
    values = []
    for name, bits, is_signed in reversed(numbers):
        most = (1 << bits) - 1
        share = (packed & most) / most
        values.append((2.0 * share - 1.0 if is_signed else share) * getattr(ranges, name))
        packed >>= bits
    return values[::-1]


def is_command(frame: CanFrame, *, is_fd: bool = False) -> bool:
    """Whether a frame is a command, and no special frame."""
    return is_data(frame, COMMAND_BYTES, is_fd=is_fd) and ending_of(frame.data) is None


def is_reply(frame: CanFrame) -> bool:
    """Whether a frame has the form of a reply."""
    return any(is_data(frame, length) for length in REPLY_BYTES)


class MitCodec(CanCodec):
    """Frames of one control cycle, see `CanCodec`.

    Args:
        node_ids: addresses of the drives, one for each joint.
        ranges: of the numbers of each drive.
        reply_identifier: identifier of all replies.
        reply_bytes: bytes of a reply.
        gains: of the loops that drives close around targets; None for torques alone.

    Attributes:
        ranges: as above.
        is_fd: all frames are CAN FD frames.
    """

    is_fd = False

    def __init__(
        self,
        node_ids: Sequence[int],
        ranges: Sequence[MitRanges],
        reply_identifier: int,
        reply_bytes: int,
        gains: DriveGains | None = None,
    ) -> None:
        super().__init__(node_ids, ())
        self._sampling = self.special_frames(Special.ENABLE)
        self._gains, self.ranges = gains, tuple(ranges)
        self._reply_identifier = reply_identifier
        self.cycle = CycleFrames(
            (), (8, reply_bytes, 8, reply_bytes),
            f"{{n}} × (request 8 bytes + command 8 bytes + 2 replies of {reply_bytes} bytes)",
        )  # fmt: skip

    def frame(self, identifier: int, data: bytes) -> CanFrame:
        """Return a frame in the format of these drives."""
        return CanFrame(identifier, data, is_fd=self.is_fd)

    def special_frames(self, kind: int) -> Sequence[CanFrame]:
        """Return a special frame for each drive."""
        return [self.frame(node_id, special(kind)) for node_id in self._node_ids]

    def reply(self, frame: CanFrame) -> tuple[int, AxisState] | None:
        if frame.identifier != self._reply_identifier or not is_reply(frame):
            return None
        joint = self._joint_of.get(frame.data[0])
        return None if joint is None else (joint, reply_of(frame.data, self.ranges[joint]))

    def command_frames(self, torque_nm: Vector, target: Matrix | None = None) -> Sequence[CanFrame]:
        torques = torque_nm.tolist()
        if target is None or self._gains is None:
            commands = [MitCommand(torque_nm=torque) for torque in torques]
        else:
            _, stiffnesses, dampings = self._gains
            columns = (*target.tolist(), stiffnesses.tolist(), dampings.tolist(), torques)
            commands = [MitCommand(*row) for row in zip(*columns, strict=True)]
        rows = zip(self._node_ids, commands, self.ranges, strict=True)
        return [
            self.frame(node_id, packed_command(command, ranges))
            for node_id, command, ranges in rows
        ]

    def read_torque(self, frame: CanFrame, torque_nm: Vector) -> int | None:
        joint = self._joint_of.get(frame.identifier)
        if joint is None or not is_command(frame, is_fd=self.is_fd):
            return None
        torque_nm[joint] = command_of(frame.data, self.ranges[joint]).torque_nm
        return joint

"""Cyclic frames of CiA 402 drives in their default PDO mapping (see the EDS).

A cycle is SYNC, one TPDO 1 from each drive (position, velocity) and, in cyclic synchronous torque
mode, one RPDO 1 to each (controlword, target torque). In position mode it is one RPDO 4 to each
(velocity offset) and then one RPDO 3 (controlword, target position, torque offset), which makes it
complete.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.can.codec import AxisState, CanCodec
from bus_schema.can.frame import CanFrame, is_data
from bus_schema.can.frame_timing import CycleFrames
from bus_schema.configuration import ConfigurationError, expand
from bus_schema.drive_feedback import DriveGains
from bus_schema.link.can_configuration import CanConfiguration
from bus_schema.robot_description import RobotDescription

SYNC = 0x080
TPDO_1, RPDO_1, RPDO_4 = 0x180, 0x200, 0x500
ENABLE_OPERATION, QUICK_STOP = 0x000F, 0x0002
"""Controlwords."""

_STATE = struct.Struct("<ii")
_OFFSET = struct.Struct("<i")

PEAK_TO_RATED = 32.0
"""Effort limit to rated torque by default: the limit is 32000 ‰, nearly all that 16 bits hold."""

_LEAST_WORD, _MOST_WORD = -(1 << 15), (1 << 15) - 1
_LONG = np.iinfo(np.int32)
_NM_PER_MILLE_MNM = 1e-6
_MILLI = 1e-3
_LARGEST_GAIN = 0xFFFF_FFFF


class Cia402Mode(NamedTuple):
    """A mode of operation, and the frames that it is commanded by.

    Attributes:
        name: as canopen calls it.
        command_pdo: number of the RPDO with the controlword.
        layout: of its data; the controlword comes first, the torque last.
        mapped: objects that the master maps into RPDOs, by their numbers, in place of RPDO 1.
        cycle: frames of a cycle.
    """

    name: str
    command_pdo: int
    layout: struct.Struct
    mapped: Mapping[int, tuple[int, ...]]
    cycle: CycleFrames


TORQUE = Cia402Mode(
    "CYCLIC SYNCHRONOUS TORQUE", 1, struct.Struct("<Hh"), {},
    CycleFrames((0,), (8, 4), "SYNC + {n} × (TPDO 8 bytes + RPDO 4 bytes)"),
)  # fmt: skip
POSITION = Cia402Mode(
    "CYCLIC SYNCHRONOUS POSITION", 3, struct.Struct("<Hih"),
    {3: (0x6040, 0x607A, 0x60B2), 4: (0x60B1,)},
    CycleFrames((0,), (8, 8, 4), "SYNC + {n} × (TPDO 8 bytes + RPDOs 8 and 4 bytes)"),
)  # fmt: skip


class Cia402Settings(NamedTuple):
    """Settings of one drive that both sides must agree on.

    Attributes:
        rated_torque_nm: unit of its torques is a thousandth of this.
    """

    rated_torque_nm: float


def rated_torque_nm(can: CanConfiguration, robot: RobotDescription) -> Vector:
    """Rated torque of each drive, shape (joints,).

    Raises:
        ConfigurationError: it is not given, and the URDF has no effort limit to take it from.
    """
    if can.rated_torque_nm is not None:
        return expand(can.rated_torque_nm, robot.joints, "link.can.rated_torque_nm")
    for name, limit in zip(robot.joint_names, robot.effort_limits_nm, strict=True):
        if not math.isfinite(limit):
            allowed = f"must be given: the URDF has no effort limit for joint {name}"
            raise ConfigurationError("link.can.rated_torque_nm", None, allowed)
    return np.asarray(robot.effort_limits_nm / PEAK_TO_RATED)


class Cia402Codec(CanCodec):
    """Frames of one control cycle, see `CanCodec`.

    Args:
        node_ids: addresses of the drives, one for each joint.
        counts_per_turn: increments per turn of the joint.
        rated_nm: rated torques, shape (joints,); drives know them in whole mN m.
        gains: of the loops that drives close in position mode; None for torque mode.
        is_fd: states and torques go in frames of CAN FD; SYNC, which has no data, does not.

    Attributes:
        mode: what the drives are to do.
        loop_gains: objects 0x60FB:01 and 0x60F9:01 of each drive, see `loop_gains`; else empty.
        rated_mnm: rated torques as object 0x6076 has them, shape (joints,).

    Raises:
        ConfigurationError: drives cannot have such gains.
    """

    def __init__(
        self,
        node_ids: Sequence[int],
        counts_per_turn: int,
        rated_nm: Vector,
        *,
        gains: DriveGains | None = None,
        is_fd: bool = False,
    ) -> None:
        super().__init__(node_ids, [CanFrame(SYNC)])
        self._is_fd = is_fd
        self.mode = TORQUE if gains is None else POSITION
        self.loop_gains = [] if gains is None else loop_gains(gains)
        self.cycle = self.mode.cycle
        if is_fd:
            self.cycle = self.cycle._replace(is_fd=True, words=f"{self.cycle.words} in FD frames")
        self.rated_mnm: NDArray[np.int64] = np.rint(rated_nm * 1000.0).astype(np.int64)
        self._units_nm: list[float] = (self.rated_mnm * _NM_PER_MILLE_MNM).tolist()
        self._rad_per_count = 2.0 * math.pi / counts_per_turn
        self._controlword = ENABLE_OPERATION
        first_rpdo = RPDO_1 + 0x100 * (self.mode.command_pdo - 1)
        self._rpdos = [first_rpdo + node_id for node_id in node_ids]
        self._offsets = [RPDO_4 + node_id for node_id in node_ids]
        self._joint_of_tpdo = {TPDO_1 + node: joint for joint, node in enumerate(node_ids)}
        self._joint_of_rpdo = {rpdo: joint for joint, rpdo in enumerate(self._rpdos)}

    def reply(self, frame: CanFrame) -> tuple[int, AxisState] | None:
        joint = self._joint_of_tpdo.get(frame.identifier)
        if joint is None or not is_data(frame, _STATE.size, is_fd=self._is_fd):
            return None
        counts, counts_s = _STATE.unpack(frame.data)
        scale = self._rad_per_count
        return joint, AxisState(self._node_ids[joint], counts * scale, counts_s * scale)

    def command_frames(self, torque_nm: Vector, target: Matrix | None = None) -> Sequence[CanFrame]:
        if self.mode is POSITION:
            return self._position_frames(torque_nm, self._target_or_last(target))
        controlword, is_fd, pack = self._controlword, self._is_fd, self.mode.layout.pack
        # One by one: NumPy's three calls take longer for the joints of an arm.
        return [
            CanFrame(rpdo, pack(controlword, _word(torque / unit)), is_fd=is_fd)
            for rpdo, torque, unit in zip(
                self._rpdos, torque_nm.tolist(), self._units_nm, strict=True
            )
        ]

    def begin_quick_stop(self) -> None:
        """From now on the controlword that goes with each torque asks for a quick stop."""
        self._controlword = QUICK_STOP

    def read_torque(self, frame: CanFrame, torque_nm: Vector) -> int | None:
        joint = self._joint_of_rpdo.get(frame.identifier)
        if joint is None or not is_data(frame, self.mode.layout.size, is_fd=self._is_fd):
            return None
        torque_nm[joint] = self.mode.layout.unpack(frame.data)[-1] * self._units_nm[joint]
        return joint

    def _position_frames(self, torque_nm: Vector, target: Matrix) -> list[CanFrame]:
        counts = np.rint(target / self._rad_per_count)
        positions, velocities = np.clip(counts, _LONG.min, _LONG.max).astype(np.int64).tolist()
        offsets = [
            CanFrame(offset, _OFFSET.pack(velocity), is_fd=self._is_fd)
            for offset, velocity in zip(self._offsets, velocities, strict=True)
        ]
        rows = zip(self._rpdos, positions, torque_nm.tolist(), self._units_nm, strict=True)
        pack = self.mode.layout.pack
        return offsets + [
            CanFrame(
                rpdo, pack(self._controlword, position, _word(torque / unit)), is_fd=self._is_fd
            )
            for rpdo, position, torque, unit in rows
        ]


def _word(per_mille: float) -> int:
    """Thousandths of the rated torque as 16 bits hold them: to the nearest, even if in between."""
    return round(min(max(per_mille, _LEAST_WORD), _MOST_WORD))


def loop_gains(gains: DriveGains) -> list[tuple[int, int]]:
    """Objects 0x60FB:01 and 0x60F9:01 of each drive: 1/1000 s and mN m s/rad.

    Raises:
        ConfigurationError: a loop of position around velocity cannot have such gains.
    """
    found = []
    rows = zip(gains.stiffness_nm_rad.tolist(), gains.damping_nm_s.tolist(), strict=True)
    for stiffness, damping in rows:
        velocity_gain = round(damping / _MILLI)
        position_gain = round(stiffness / damping / _MILLI) if damping else 0
        if not 0 < velocity_gain <= _LARGEST_GAIN or position_gain > _LARGEST_GAIN:
            raise ConfigurationError(
                "plant.drive_feedback.damping_nm_s", damping,
                "must be at least 0.001 with CiA 402, and stiffness_nm_rad at most 4e6 times it:"
                " the position loop is around the velocity loop",
            )  # fmt: skip
        found.append((position_gain, velocity_gain))
    return found

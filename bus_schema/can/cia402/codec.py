"""Cyclic frames of CiA 402 drives in their default PDO mapping (see the EDS).

A cycle is SYNC, one TPDO 1 from each drive (position, velocity) and one RPDO 1 to each
(controlword, target torque).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Vector
from bus_schema.can.frame import CanFrame, is_classical_data, is_data
from bus_schema.can.frame_timing import CycleFrames
from bus_schema.configuration import ConfigurationError, expand
from bus_schema.link.can_configuration import CanConfiguration
from bus_schema.robot_description import RobotDescription

SYNC = 0x080
TPDO_1, RPDO_1 = 0x180, 0x200
ENABLE_OPERATION, QUICK_STOP = 0x000F, 0x0002
"""Controlwords."""

_STATE = struct.Struct("<ii")
_COMMAND = struct.Struct("<Hh")
_SYNC_FRAMES = (CanFrame(SYNC),)

PEAK_TO_RATED = 32.0
"""Effort limit to rated torque by default: the limit is 32000 ‰, nearly all that 16 bits hold."""

_LEAST_WORD, _MOST_WORD = -(1 << 15), (1 << 15) - 1
_NM_PER_MILLE_MNM = 1e-6


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


class Cia402Codec:
    """Frames of one control cycle, see `CanCodec`.

    Args:
        node_ids: addresses of the drives, one for each joint.
        counts_per_turn: increments per turn of the joint.
        rated_nm: rated torques, shape (joints,); drives know them in whole mN m.
        is_fd: states and torques go in frames of CAN FD; SYNC, which has no data, does not.

    Attributes:
        rated_mnm: rated torques as object 0x6076 has them, shape (joints,).
    """

    cycle = CycleFrames((0,), (8, 4), "SYNC + {n} × (TPDO 8 bytes + RPDO 4 bytes)")

    def __init__(
        self,
        node_ids: Sequence[int],
        counts_per_turn: int,
        rated_nm: Vector,
        *,
        is_fd: bool = False,
    ) -> None:
        self._is_fd = is_fd
        if is_fd:
            self.cycle = self.cycle._replace(is_fd=True, words=f"{self.cycle.words} in FD frames")
        self.rated_mnm: NDArray[np.int64] = np.rint(rated_nm * 1000.0).astype(np.int64)
        self._nm_per_mille = self.rated_mnm * _NM_PER_MILLE_MNM
        self._units_nm: list[float] = self._nm_per_mille.tolist()
        self._rad_per_count = 2.0 * math.pi / counts_per_turn
        self._controlword = ENABLE_OPERATION
        self._rpdos = [RPDO_1 + node_id for node_id in node_ids]
        self._joint_of_tpdo = {TPDO_1 + node: joint for joint, node in enumerate(node_ids)}
        self._joint_of_rpdo = {rpdo: joint for joint, rpdo in enumerate(self._rpdos)}

    def sampling_frames(self) -> Sequence[CanFrame]:
        return _SYNC_FRAMES

    def is_sampling(self, frame: CanFrame) -> bool:
        return frame.identifier == SYNC and is_classical_data(frame, 0)

    def read_state(self, frame: CanFrame, position: Vector, velocity: Vector) -> int | None:
        joint = self._joint_of_tpdo.get(frame.identifier)
        if joint is None or not is_data(frame, _STATE.size, is_fd=self._is_fd):
            return None
        counts, counts_per_s = _STATE.unpack(frame.data)
        position[joint] = counts * self._rad_per_count
        velocity[joint] = counts_per_s * self._rad_per_count
        return joint

    def torque_frames(self, torque_nm: Vector) -> Sequence[CanFrame]:
        controlword, is_fd = self._controlword, self._is_fd
        # One by one: NumPy's three calls take longer for the joints of an arm.
        return [
            CanFrame(rpdo, _COMMAND.pack(controlword, _word(torque / unit)), is_fd=is_fd)
            for rpdo, torque, unit in zip(
                self._rpdos, torque_nm.tolist(), self._units_nm, strict=True
            )
        ]

    def begin_quick_stop(self) -> None:
        """From now on the controlword that goes with each torque asks for a quick stop."""
        self._controlword = QUICK_STOP

    def read_torque(self, frame: CanFrame, torque_nm: Vector) -> int | None:
        joint = self._joint_of_rpdo.get(frame.identifier)
        if joint is None or not is_data(frame, _COMMAND.size, is_fd=self._is_fd):
            return None
        _, word = _COMMAND.unpack(frame.data)
        torque_nm[joint] = word * self._units_nm[joint]
        return joint


def _word(per_mille: float) -> int:
    """Thousandths of the rated torque as 16 bits hold them: to the nearest, even if in between."""
    return round(min(max(per_mille, _LEAST_WORD), _MOST_WORD))

"""Cyclic frames of CiA 402 drives in their default PDO mapping (see the EDS).

A cycle is SYNC, one TPDO 1 from each drive (position, velocity) and one RPDO 1 to each
(controlword, target torque).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

from bus_schema.arrays import Vector
from bus_schema.can.frame import CanFrame, is_classical_data
from bus_schema.can.units import DriveUnits

SYNC = 0x080
TPDO_1, RPDO_1 = 0x180, 0x200
ENABLE_OPERATION, QUICK_STOP = 0x000F, 0x0002
"""Controlwords."""

_STATE = struct.Struct("<ii")
_COMMAND = struct.Struct("<Hh")
_SYNC_FRAMES = (CanFrame(SYNC),)


class Cia402Codec:
    """Frames of one control cycle.

    Args:
        node_ids: addresses of the drives, one for each joint.
        units: what their numbers mean.

    Attributes:
        controlword: controlword that goes with each torque.
    """

    def __init__(self, node_ids: Sequence[int], units: DriveUnits) -> None:
        self.units = units
        self.controlword = ENABLE_OPERATION
        self._rpdos = [RPDO_1 + node_id for node_id in node_ids]
        self._joint_of_tpdo = {TPDO_1 + node: joint for joint, node in enumerate(node_ids)}
        self._joint_of_rpdo = {rpdo: joint for joint, rpdo in enumerate(self._rpdos)}

    def sampling_frames(self) -> Sequence[CanFrame]:
        return _SYNC_FRAMES

    def is_sampling(self, frame: CanFrame) -> bool:
        return frame.identifier == SYNC and is_classical_data(frame, 0)

    def read_state(self, frame: CanFrame, position: Vector, velocity: Vector) -> int | None:
        joint = self._joint_of_tpdo.get(frame.identifier)
        if joint is None or not is_classical_data(frame, _STATE.size):
            return None
        counts, counts_per_s = _STATE.unpack(frame.data)
        position[joint] = counts * self.units.rad_per_count
        velocity[joint] = counts_per_s * self.units.rad_per_count
        return joint

    def torque_frames(self, torque_nm: Vector) -> Sequence[CanFrame]:
        words = self.units.torque_words(torque_nm)
        return [
            CanFrame(rpdo, _COMMAND.pack(self.controlword, word))
            for rpdo, word in zip(self._rpdos, words, strict=True)
        ]

    def read_torque(self, frame: CanFrame, torque_nm: Vector) -> int | None:
        joint = self._joint_of_rpdo.get(frame.identifier)
        if joint is None or not is_classical_data(frame, _COMMAND.size):
            return None
        _, word = _COMMAND.unpack(frame.data)
        torque_nm[joint] = self.units.torque_nm(joint, word)
        return joint

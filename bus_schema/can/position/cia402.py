"""CiA 402 drives in cyclic synchronous position mode: their cyclic frames, and their master.

A cycle is SYNC, one TPDO 1 from each drive (position, velocity), one RPDO 4 to each (velocity
offset) and then one RPDO 3 (controlword, target position, torque offset), which makes it complete.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
from canopen.profiles.p402 import BaseNode402
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.can.cia402.codec import Cia402Codec
from bus_schema.can.cia402.master import Cia402Master
from bus_schema.can.frame import CanBus, CanFrame, is_data
from bus_schema.can.frame_timing import CycleFrames
from bus_schema.can.position.aiming import AimingCodec, AimingMaster
from bus_schema.configuration import ConfigurationError
from bus_schema.drive_feedback import DriveGains
from bus_schema.link.can_configuration import CanConfiguration

_RPDO_3, _RPDO_4 = 0x400, 0x500
_TARGET, _OFFSET = struct.Struct("<Hih"), struct.Struct("<i")
_LONG = np.iinfo(np.int32)
_MAPPED = {3: (0x6040, 0x607A, 0x60B2), 4: (0x60B1,)}
_MILLI = 1e-3
_LARGEST_GAIN = 0xFFFF_FFFF


class Cia402PositionCodec(AimingCodec, Cia402Codec):
    """Frames of one control cycle, see `TargetCodec` and `AimingCodec`."""

    cycle = CycleFrames((0,), (8, 8, 4), "SYNC + {n} × (TPDO 8 bytes + RPDOs 8 and 4 bytes)")

    def __init__(
        self,
        node_ids: Sequence[int],
        counts_per_turn: int,
        rated_nm: Vector,
        *,
        is_fd: bool = False,
    ) -> None:
        super().__init__(node_ids, counts_per_turn, rated_nm, is_fd=is_fd)
        self._targets = [_RPDO_3 + node_id for node_id in node_ids]
        self._offsets = [_RPDO_4 + node_id for node_id in node_ids]
        self._joint_of_target = {each: joint for joint, each in enumerate(self._targets)}
        self._seen = np.zeros((2, len(node_ids)))

    def read_torque(self, frame: CanFrame, torque_nm: Vector) -> int | None:
        joint = self._joint_of_target.get(frame.identifier)
        if joint is None or not is_data(frame, _TARGET.size, is_fd=self._is_fd):
            return None
        torque_nm[joint] = _TARGET.unpack(frame.data)[2] * self._nm_per_mille[joint]
        return joint

    def _frames(self, torque_nm: Vector, target: Matrix) -> list[CanFrame]:
        counts = np.rint(target / self._rad_per_count)
        positions, velocities = np.clip(counts, _LONG.min, _LONG.max).astype(np.int64).tolist()
        rows = zip(self._targets, positions, self._words(torque_nm), strict=True)
        return [
            *(
                CanFrame(identifier, _OFFSET.pack(velocity), is_fd=self._is_fd)
                for identifier, velocity in zip(self._offsets, velocities, strict=True)
            ),
            *(
                CanFrame(
                    identifier,
                    _TARGET.pack(self._controlword, position, word),
                    is_fd=self._is_fd,
                )
                for identifier, position, word in rows
            ),
        ]

    def _words(self, torque_nm: Vector) -> list[int]:
        words: NDArray[np.float64] = np.rint(torque_nm / self._nm_per_mille)
        limits = np.iinfo(np.int16)
        return [int(word) for word in np.clip(words, limits.min, limits.max).tolist()]


class Cia402PositionMaster(AimingMaster, Cia402Master):
    """The master.

    It maps RPDO 3 and 4, and writes the gains to objects 0x60FB and 0x60F9, whose contents each
    maker decides on: these are those of our description.

    Args:
        gains: of the drives' loops.
        others: as in `Cia402Master`.
    """

    mode = "CYCLIC SYNCHRONOUS POSITION"
    command_pdo = 3
    _codec: Cia402PositionCodec

    def __init__(
        self,
        bus: CanBus,
        can: CanConfiguration,
        node_ids: tuple[int, ...],
        codec: Cia402PositionCodec,
        gains: DriveGains,
    ) -> None:
        super().__init__(bus, can, node_ids, codec)
        self._gains = loop_gains(gains)

    def _prepare(self, node: BaseNode402) -> None:
        node.rpdo.read()  # type: ignore[no-untyped-call]
        node.rpdo[1].enabled = False
        for number, objects in _MAPPED.items():
            pdo = node.rpdo[number]
            pdo.clear()
            for index in objects:
                pdo.add_variable(index)
            pdo.enabled = True
        node.rpdo.save()  # type: ignore[no-untyped-call]
        position_gain, velocity_gain = self._gains[self._nodes.index(node)]
        self._set(node, 0x60FB, 1, position_gain)
        self._set(node, 0x60F9, 1, velocity_gain)
        self._set(node, 0x60F9, 2, 0)

    def _before_enabling(self, node: BaseNode402) -> None:
        """The first target is where the joint is: any other would be a step."""
        node.rpdo[3]["Target position"].raw = node.sdo[0x6064].raw


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

"""A drive protocol as the bus sees it.

A cycle is one frame that samples all drives, the answer of each, and a torque to each.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import Annotated

from pydantic import Field

from bus_schema.arrays import Matrix, Vector
from bus_schema.can.frame import CanFrame
from bus_schema.can.frame_timing import CycleFrames
from bus_schema.can.master import CanMaster
from bus_schema.can.protocol import DriveProtocol
from bus_schema.configuration import StrictModel, Whole
from bus_schema.drive_feedback import DriveGains
from bus_schema.link.can_configuration import CanConfiguration
from bus_schema.robot_description import RobotDescription

STATE, TORQUE, REST = 0x100, 0x200, 0x300


class ToyCodec:
    cycle = CycleFrames((0,), (8, 4), "sample + {n} × (state 8 bytes + torque 4 bytes)")

    def __init__(self, node_ids: Sequence[int], sample_identifier: int) -> None:
        self._node_ids, self._sample = node_ids, CanFrame(sample_identifier)

    def sampling_frames(self) -> Sequence[CanFrame]:
        return [self._sample]

    def is_sampling(self, frame: CanFrame) -> bool:
        return frame.identifier == self._sample.identifier

    def read_state(self, frame: CanFrame, position: Vector, velocity: Vector) -> int | None:
        joint = self._joint(frame, STATE)
        if joint is not None:
            position[joint], velocity[joint] = struct.unpack("<ff", frame.data)
        return joint

    def command_frames(self, torque_nm: Vector, target: Matrix | None = None) -> Sequence[CanFrame]:
        return [
            CanFrame(TORQUE + node, struct.pack("<f", torque))
            for node, torque in zip(self._node_ids, torque_nm, strict=True)
        ]

    def read_torque(self, frame: CanFrame, torque_nm: Vector) -> int | None:
        joint = self._joint(frame, TORQUE)
        if joint is not None:
            (torque_nm[joint],) = struct.unpack("<f", frame.data)
        return joint

    def _joint(self, frame: CanFrame, function: int) -> int | None:
        node = frame.identifier - function
        return self._node_ids.index(node) if node in self._node_ids else None


class ToyMaster(CanMaster):
    """Drives follow the first torque they get, and rest on request."""

    def enable(self, timeout_s: float, is_stop_requested: Callable[[], bool]) -> bool:
        self._is_powered = [True] * len(self._node_ids)
        return True

    def command(self, torque_nm: Vector) -> None:
        if self._is_stopping:
            self._send([CanFrame(REST)])
            self._is_powered = [False] * len(self._node_ids)
        else:
            super().command(torque_nm)

    def leave(self) -> None:
        self._send([CanFrame(REST)])


class ToySettings(StrictModel):
    """The section ``link.can.settings``."""

    sample_identifier: Annotated[Whole, Field(ge=1, le=0xFF)] = 0x010


class ToyProtocol(DriveProtocol):
    title = "Toy"
    largest_node_id = 9
    master = ToyMaster
    settings_type = ToySettings

    def codec(
        self, can: CanConfiguration, robot: RobotDescription, gains: DriveGains | None = None
    ) -> ToyCodec:
        sample_identifier = self.settings(can).sample_identifier
        return ToyCodec(self.node_ids(can, robot.joints), sample_identifier)

    def own_settings(
        self, can: CanConfiguration, robot: RobotDescription
    ) -> tuple[ToySettings, ...]:
        return (self.settings(can),) * robot.joints

"""The drives of the protocol."""

from __future__ import annotations

import struct

from bus_schema.can.frame import CanFrame
from funnel_hil_example.protocol import REST, STATE, TORQUE
from plant_emulator.drives.drive import (
    AT_REST,
    Drive,
    DriveFault,
    DriveSettings,
    JointDemand,
    Send,
)


class ToyDrive(Drive):
    targets = samplings = 0

    def __init__(self, settings: DriveSettings, send: Send) -> None:
        super().__init__(settings, send)
        self._node_id, self._sample = settings.node_id, settings.own.sample_identifier
        self.identifiers = (self._sample, TORQUE + self._node_id, REST)
        self._torque_nm: float | None = None

    @property
    def status(self) -> str:
        return "at rest" if self._torque_nm is None else "following"

    def receive(self, frame: CanFrame, now_ns: int) -> bool:
        if frame.identifier == self._sample:
            self.samplings += 1
            data = struct.pack("<ff", self._reading.position_rad, self._reading.velocity_rad_s)
            self._send(CanFrame(STATE + self._node_id, data))
        elif frame.identifier == TORQUE + self._node_id:
            (self._torque_nm,) = struct.unpack("<f", frame.data)
            self.targets += 1
        elif frame.identifier == REST:
            self._torque_nm = None
        else:
            return False
        return True

    def demand(self) -> JointDemand:
        return AT_REST if self._torque_nm is None else JointDemand(self._torque_nm, True)

    def advance(self, now_ns: int) -> None: ...

    def _fail(self, fault: DriveFault, now_ns: int) -> None: ...

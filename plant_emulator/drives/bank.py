"""The drives of a robot, between its joints and the CAN bus.

For a plant in lockstep the bank counts what the controller does: `samplings` rises when it has
sampled every axis (a SYNC; or, without one, a request to each axis), `take_targets` is true once it
has given every axis a new target.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Vector
from bus_schema.can.frame import BUS_OFF, BUS_RESTARTED, CanFrame
from bus_schema.errors import InvalidMessageError, Rejections
from plant_emulator.arm_plant import ArmPlant
from plant_emulator.drives.drive import Drive, DriveFault, DriveSettings, JointReading, Loop, Send

logger = logging.getLogger(__name__)


class DriveBank:
    """The drives of a robot, in the order of its joints.

    Args:
        protocol: class of the drives.
        settings: one for each joint.
        send: takes every frame that a drive sends.

    Attributes:
        node_ids: addresses, in the order of the joints.
        rejections: frames that no drive could use, by reason.
    """

    def __init__(
        self, protocol: type[Drive[Any]], settings: Sequence[DriveSettings[Any]], send: Send
    ) -> None:
        self._most_bytes, self._takes_extended = protocol.most_bytes, protocol.takes_extended
        self._drives = [protocol(each, send) for each in settings]
        self._routes: dict[int, list[Drive[Any]]] = {}
        for drive in self._drives:
            drive.on_set_up = self._routes.clear
        self.node_ids = tuple(each.node_id for each in settings)
        self._torque_nm: Vector = np.zeros(len(self._drives))
        self._loops: list[Loop | None] = [None] * len(self._drives)
        self._no_loops = self._loops.copy()
        self._braked: NDArray[np.bool_] = np.ones(len(self._drives), dtype=np.bool_)
        self._is_stale = True
        self._reads_fd = any(each.fd_process_data for each in settings)
        self.rejections = Rejections("frame", logger)

    @property
    def samplings(self) -> int:
        """Number of times that the controller has sampled all axes still on the bus."""
        fewest = -1
        for drive in self._drives:  # a loop, as it is asked after every frame
            if not drive.is_silent:
                count = drive.samplings
                fewest = count if fewest < 0 or count < fewest else fewest
        return max(fewest, 0)

    @property
    def faults(self) -> list[str]:
        """One sentence for each drive with a fault."""
        rows = zip(self.node_ids, self._drives, strict=True)
        return [f"node {node_id}: {drive.fault}" for node_id, drive in rows if drive.fault]

    @property
    def statuses(self) -> list[str]:
        """State and fault of each drive."""
        return [
            f"node {node_id}: {drive.status}" + (f", {drive.fault}" if drive.fault else "")
            for node_id, drive in zip(self.node_ids, self._drives, strict=True)
        ]

    def take_targets(self) -> bool:
        """Whether all drives still on the bus got a target since this was last true."""
        for drive in self._drives:  # asked after every frame, too
            if not drive.is_silent and drive.targets <= drive.targets_taken:
                return False
        listening = [drive for drive in self._drives if not drive.is_silent]
        for drive in listening:
            drive.targets_taken = drive.targets
        return bool(listening)

    def measure(self, position_rad: Vector, velocity_rad_s: Vector, torque_nm: Vector) -> None:
        """Pass the measured joints to the drives, shape (joints,) each."""
        rows = zip(position_rad.tolist(), velocity_rad_s.tolist(), torque_nm.tolist(), strict=True)
        for drive, (position, velocity, torque) in zip(self._drives, rows, strict=True):
            drive.measure(JointReading(*drive.seen(position, velocity), torque))
        self._is_stale = True

    @property
    def torque_nm(self) -> Vector:
        """Torques of the drives, shape (joints,)."""
        self._refresh()
        return self._torque_nm

    @property
    def braked(self) -> NDArray[np.bool_]:
        """Whether each brake is engaged, shape (joints,)."""
        self._refresh()
        return self._braked

    @property
    def closes_loops(self) -> bool:
        """Whether the torque of any drive follows its joint's motion."""
        self._refresh()
        return self._loops != self._no_loops

    def stretches(
        self, arm: ArmPlant, first: int, end: int, substep_s: float
    ) -> Iterator[tuple[int, int]]:
        """Stretches of substeps through which `torque_nm` holds, as the arm gets to each.

        Where a drive's torque follows its joint's motion, each substep is one.
        """
        if not self.closes_loops:
            yield first, end
            return
        for number in range(first, end):
            for joint, (drive, loop) in enumerate(zip(self._drives, self._loops, strict=True)):
                if loop is not None:
                    motion = float(arm.position[joint]), float(arm.velocity[joint])
                    self._torque_nm[joint] = loop.torque_nm(*drive.seen(*motion), substep_s)
            yield number, number + 1

    def receive(self, frame: CanFrame, now_ns: int) -> None:
        """Pass a frame from the bus to the drives that use it, and count refused frames."""
        if frame.is_error:
            self._take_controller_error(frame, now_ns)
            return
        try:
            self._deliver(frame, now_ns)
        except InvalidMessageError as error:
            self.rejections.note(error)
            self._is_stale = True

    def advance(self, now_ns: int) -> None:
        """Advance the drives to `now_ns`."""
        for drive in self._drives:
            drive.advance(now_ns)
        self._is_stale = True

    def inject(self, joint: int, fault: DriveFault, now_ns: int) -> None:
        """Inject a fault into the drive of a joint (counted from 0)."""
        self._drives[joint].inject(fault, now_ns)
        self._is_stale = True

    def clear(self, joint: int, fault: DriveFault, now_ns: int) -> None:
        """Remove the cause of a fault."""
        self._drives[joint].clear(fault, now_ns)
        self._is_stale = True

    def describe(self, frame: CanFrame) -> str:
        """Describe a frame in words."""
        if frame.is_fd and not self._reads_fd:
            return "a CAN FD frame, which these drives do not read"
        for drive in self._drives:
            text = drive.describe(frame)
            if text is not None:
                return text
        return "not for these drives"

    def _deliver(self, frame: CanFrame, now_ns: int) -> None:
        is_strange = frame.is_extended and not self._takes_extended
        if is_strange or (frame.is_fd and not self._reads_fd) or len(frame.data) > self._most_bytes:
            raise InvalidMessageError("no_classical_frame", f"drives do not use {frame}")
        concerned = self._routes.get(frame.identifier)
        if concerned is None:
            concerned = [each for each in self._drives if frame.identifier in each.identifiers]
            if concerned:  # do not store the many 29-bit identifiers of no drive
                self._routes[frame.identifier] = concerned
        understood = False
        for drive in concerned:
            if not drive.is_silent and drive.receive(frame, now_ns):
                understood = self._is_stale = True
        if not understood:
            raise InvalidMessageError("unknown_identifier", f"no drive receives {frame}")

    def _take_controller_error(self, frame: CanFrame, now_ns: int) -> None:
        for drive in self._drives:
            if frame.identifier & BUS_OFF:
                drive.lose_bus(now_ns)
            if frame.identifier & BUS_RESTARTED:
                drive.regain_bus(now_ns)
        self._is_stale = True

    def _refresh(self) -> None:
        """Update the drives' demands if anything has changed."""
        if not self._is_stale:
            return
        self._is_stale = False  # first: what a thread brings in meanwhile is for the next time
        for joint, drive in enumerate(self._drives):
            self._torque_nm[joint], is_released, self._loops[joint] = drive.demand()
            self._braked[joint] = not is_released

"""Emulated drives and their bus, with frame times, log and bus-off."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence

import numpy as np

from bus_schema.can.frame import BUS_OFF, CanBus, CanFrame
from bus_schema.can.medium import CanMedium
from plant_emulator.arm_plant import ArmPlant
from plant_emulator.drives.bank import DriveBank
from plant_emulator.drives.drive import Send
from plant_emulator.drives.fault_plan import PlannedFault, schedule_faults
from plant_emulator.faults.fault import report_nothing


class DrivesOnBus:
    """Drives on a bus.

    Args:
        bus: the bus.
        faults: faults of drives, in the time of the run.
        build: returns the drives, given the function that sends their frames.
        medium: times and logs the frames.
        delay_ns: delay from a remote master to the drives during the run.

    Attributes:
        bank: the drives.
        medium: as above.
        delay_ns: as above.
        answers: frames that the drives sent during the last `handle` or `advance`.
        is_off: the bus is lost for good.
    """

    def __init__(
        self,
        bus: CanBus,
        faults: Sequence[PlannedFault],
        build: Callable[[Send], DriveBank],
        medium: CanMedium,
        delay_ns: int = 0,
    ) -> None:
        self._bus = bus
        self.medium = medium
        self.delay_ns = delay_ns
        self._under_way: deque[tuple[int, CanFrame]] = deque()
        self.answers: list[CanFrame] = []
        self.is_off = False
        self._began_ns = 0
        self._is_running = False
        self.bank = build(self._send)
        self._faults = schedule_faults(faults, self.bank)

    def receive(self, timeout_s: float) -> CanFrame | None:
        """Return the next frame of another node; None if none arrives within `timeout_s`."""
        return self._bus.receive(timeout_s)

    def dropped(self) -> int | None:
        """Number of frames that the socket dropped; None if it does not count them."""
        return self._bus.dropped()

    def begin_run(self, now_ns: int) -> None:
        """Set the run's time 0 to now; the drives' own time continues."""
        self._began_ns, self._is_running = now_ns, True
        self._faults.postpone(now_ns)
        self.medium.start_counting()

    def handle_later(self, frame: CanFrame, now_ns: int) -> None:
        """Send a frame from a remote master to the drives, with the link's delay."""
        self._under_way.append((now_ns + self.delay_ns, frame))

    def handle_due(self, now_ns: int) -> None:
        """Pass the remote frames to the drives that have arrived by now."""
        while self._under_way and self._under_way[0][0] <= now_ns:
            due_ns, frame = self._under_way.popleft()
            self.handle(frame, due_ns)

    def end_run(self, now_ns: int) -> None:
        """End the link's delay."""
        self.handle_due(now_ns + self.delay_ns)
        self.delay_ns = 0

    def handle(self, frame: CanFrame, now_ns: int) -> None:
        """Pass a frame to the drives, unless the bus is off."""
        self.answers.clear()
        if self.is_off:
            return
        self.bank.receive(frame, self._began_ns + now_ns)
        self._send_answers()
        if not frame.is_error:  # an error frame is a report of the local controller
            self.medium.carry((frame,), now_ns)
        self.medium.carry(self.answers, now_ns)

    def advance(self, now_ns: int, on_fault: Callable[[str], None] = report_nothing) -> None:
        """Apply planned faults, each announced by `on_fault`, and advance the drives."""
        self.answers.clear()
        if self._is_running:
            self._faults.run_due(self._began_ns + now_ns, on_fault)
        self.bank.advance(self._began_ns + now_ns)
        self._send_answers()
        self.medium.carry(self.answers, now_ns)

    def lose_bus(self, now_ns: int) -> None:
        """Put the drives' side into bus-off."""
        self.bank.receive(CanFrame(BUS_OFF, is_error=True), self._began_ns + now_ns)
        self.is_off = True

    def close(self) -> None:
        """Close the bus and finish its log."""
        self._bus.close()
        self.medium.close()

    def _send(self, frame: CanFrame) -> None:
        if not self.is_off:
            self.answers.append(frame)

    def _send_answers(self) -> None:
        """Send the answers before they are timed and logged, which the receivers need not await."""
        if self.answers:
            self._bus.send_all(self.answers)


class DrivenArm(ArmPlant):
    """An arm whose drives carry out all commands and stops."""

    _drives: DrivesOnBus | None = None

    def attach(self, drives: DrivesOnBus) -> None:
        """Connect the joints to their drives, which replace the configured safe stop."""
        self._drives, self._safe_stop = drives, "zero_torque"

    def advance(self, first: int, end: int) -> None:
        if self._drives is None:
            super().advance(first, end)
            return
        self._drives.handle_due(self._grid.substep_ns(first))
        bank = self._drives.bank
        self.hold(bank.braked)
        for stretch in bank.stretches(self, first, end, self._grid.substep_s):
            np.copyto(self._commanded, bank.torque_nm)
            super().advance(*stretch)

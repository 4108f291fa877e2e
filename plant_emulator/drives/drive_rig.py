"""Drives and physics in real time, for external driver code."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from bus_schema.can.frame import CanBus, CanFrame
from bus_schema.runtime.clock import Clock, TickGrid
from plant_emulator.arm_plant import ArmPlant
from plant_emulator.drives.bank import DriveBank
from plant_emulator.drives.fault_plan import PlannedFault, schedule_faults


@dataclass
class RigCounts:
    """Counts of a rig.

    Attributes:
        received: frames that came.
        ticks: ticks that passed.
        skipped: ticks at which the drives had no turn because the machine was late.
    """

    received: int = 0
    ticks: int = 0
    skipped: int = 0


class DriveRig:
    """An arm whose joints have drives on a bus.

    Brakes hold each joint until its own drive releases them.

    Args:
        arm: the arm.
        bank: its drives.
        bus: the bus they are on.
        clock: the rig's time.
        grid: when drives and physics have their turns.
        faults: what goes wrong.
        on_frame: called with every frame that comes, before the drives get it.
        on_event: called with a sentence when something happens.

    Attributes:
        counts: what it did.
    """

    def __init__(
        self,
        arm: ArmPlant,
        bank: DriveBank,
        bus: CanBus,
        clock: Clock,
        grid: TickGrid,
        *,
        faults: Sequence[PlannedFault],
        on_frame: Callable[[CanFrame], None],
        on_event: Callable[[str], None],
    ) -> None:
        self._arm, self._bank, self._bus = arm, bank, bus
        self._clock, self._grid = clock, grid
        self._faults = schedule_faults(faults, bank)
        self._on_frame, self._on_event = on_frame, on_event
        self._reported: list[str] = []
        self._stop_requested = False
        self.counts = RigCounts()

    def request_stop(self) -> None:
        """End at the next tick; safe from signal handlers and other threads."""
        self._stop_requested = True

    def run(self, ticks: int | None = None) -> None:
        """Run for a number of ticks, or until asked to stop."""
        self._clock.start()
        self._arm.begin()
        self._measure()
        while not self._stop_requested and (ticks is None or self.counts.ticks < ticks):
            self._receive_until(self._grid.tick_ns(self.counts.ticks + 1))
            now_ns = self._clock.now_ns()
            self._faults.run_due(now_ns, self._on_event)
            self._bank.advance(now_ns)
            self._report_statuses()
            self._catch_up(max(self._grid.tick_at_or_before(now_ns), self.counts.ticks + 1))
            self._measure()
        self._arm.end()

    def _receive_until(self, instant_ns: int) -> None:
        """Pass frames to the drives until the physics is due."""
        while (remaining_ns := instant_ns - self._clock.now_ns()) > 0:
            frame = self._bus.receive(remaining_ns * 1e-9)
            if frame is not None:
                self.counts.received += 1
                self._on_frame(frame)
                self._bank.receive(frame, self._clock.now_ns())

    def _catch_up(self, tick: int) -> None:
        """Advance the physics to the clock."""
        arm, bank = self._arm, self._bank
        arm.hold(bank.braked)
        self.counts.skipped += tick - self.counts.ticks - 1
        first, end = (each * self._grid.substeps for each in (self.counts.ticks, tick))
        for stretch in bank.stretches(arm, first, end, self._grid.substep_s):
            arm.command(bank.torque_nm)
            arm.advance(*stretch)
        self.counts.ticks = tick

    def _measure(self) -> None:
        self._arm.read_encoders()
        position, velocity = self._arm.measured
        self._bank.measure(position, velocity, self._arm.torques.actuator)

    def _report_statuses(self) -> None:
        """Report which drives have changed their state."""
        statuses = self._bank.statuses
        for status in statuses:
            if status not in self._reported:
                self._on_event(status)
        self._reported = statuses

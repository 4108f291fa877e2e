"""Drives and physics in real time, for external driver code."""

from __future__ import annotations

from collections.abc import Callable

from bus_schema.runtime.clock import Clock, TickGrid
from plant_emulator.drives.drives_on_bus import DrivenArm, DrivesOnBus


class DriveRig:
    """An arm whose joints have drives on a bus.

    Brakes hold each joint until its own drive releases them.

    Args:
        arm: the arm.
        drives: its drives on their bus.
        clock: the rig's time.
        grid: instants at which physics and drives advance.
        on_event: called with a sentence when a fault begins or ends, or a drive changes its state.

    Attributes:
        ticks: number of ticks so far.
        skipped: number of ticks at which the drives did not advance because the host was late.
    """

    def __init__(
        self,
        arm: DrivenArm,
        drives: DrivesOnBus,
        clock: Clock,
        grid: TickGrid,
        on_event: Callable[[str], None],
    ) -> None:
        self._arm, self._drives, self._on_event = arm, drives, on_event
        self._clock, self._grid = clock, grid
        self._statuses: list[str] = []
        self._stop_requested = False
        self.ticks = self.skipped = 0
        arm.attach(drives)

    def request_stop(self) -> None:
        """End at the next tick; safe from signal handlers and other threads."""
        self._stop_requested = True

    def run(self, ticks: int | None = None) -> None:
        """Run for a number of ticks, or until a stop is requested."""
        self._clock.start()
        self._arm.begin()
        self._arm.hold(self._drives.bank.braked)
        self._arm.command(self._drives.bank.torque_nm)  # from here on, the drives alone brake
        self._drives.begin_run(0)
        self._measure()
        while not self._stop_requested and (ticks is None or self.ticks < ticks):
            self._receive_until(self._grid.tick_ns(self.ticks + 1))
            now_ns = self._clock.now_ns()
            self._drives.advance(now_ns, self._on_event)
            self._report_statuses()
            self._catch_up(max(self._grid.tick_at_or_before(now_ns), self.ticks + 1))
            self._measure()
        self._arm.end()

    def _receive_until(self, instant_ns: int) -> None:
        """Pass frames to the drives until the physics is due."""
        while (remaining_ns := instant_ns - self._clock.now_ns()) > 0:
            frame = self._drives.receive(remaining_ns * 1e-9)
            if frame is not None:
                self._drives.handle(frame, self._clock.now_ns())
        self._drives.medium.catch_up()

    def _catch_up(self, tick: int) -> None:
        """Advance the physics to the clock."""
        self.skipped += tick - self.ticks - 1
        self._arm.advance(self.ticks * self._grid.substeps, tick * self._grid.substeps)
        self.ticks = tick

    def _measure(self) -> None:
        self._arm.read_encoders()
        position, velocity = self._arm.measured
        self._drives.bank.measure(position, velocity, self._arm.torques.actuator)

    def _report_statuses(self) -> None:
        """Report the drives whose state has changed."""
        statuses = self._drives.bank.statuses
        for status in statuses:
            if status not in self._statuses:
                self._on_event(status)
        self._statuses = statuses

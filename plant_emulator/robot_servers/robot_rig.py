"""An arm in real time whose own controller obeys the clients of a robot server."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bus_schema.runtime.clock import Clock, TickGrid
from plant_emulator.arm_plant import ArmPlant
from plant_emulator.robot_servers.robot_server import RobotServer


class RobotRig:
    """Physics and clients of an emulated robot.

    Args:
        arm: the arm; the server's interface moves it.
        server: answers the clients.
        clock: the rig's time.
        grid: instants at which physics and clients advance.
        record: called at the start and once per tick, with its number and whether it is skipped.

    Attributes:
        ticks: number of ticks so far.
        skipped: number of ticks at which no client was served because the host was late.
    """

    def __init__(
        self,
        arm: ArmPlant,
        server: RobotServer,
        clock: Clock,
        grid: TickGrid,
        record: Callable[[int, bool], None],
    ) -> None:
        self._arm, self._server, self._clock, self._grid = arm, server, clock, grid
        self._record = record
        self._stop_requested = False
        self.ticks = self.skipped = 0

    def request_stop(self) -> None:
        """End at the next tick; safe from signal handlers and other threads."""
        self._stop_requested = True

    def run(self, ticks: int | None = None) -> None:
        """Run for a number of ticks, or until a stop is requested."""
        arm, grid = self._arm, self._grid
        self._clock.start()
        arm.begin()
        arm.command(np.zeros(len(arm.joint_names)))  # the robot's controller releases the brakes
        arm.read_encoders()
        self._record(0, False)
        while not self._stop_requested and (ticks is None or self.ticks < ticks):
            due_ns = grid.tick_ns(self.ticks + 1)
            self._server.serve(0.0)  # clients are served also while the host is late
            while (left_ns := due_ns - self._clock.now_ns()) > 0:
                self._server.serve(1e-9 * left_ns)
            tick = max(grid.tick_at_or_before(self._clock.now_ns()), self.ticks + 1)
            self._advance_to(tick if ticks is None else min(tick, ticks))
            now_s = 1e-9 * grid.tick_ns(self.ticks)
            self._server.cycle(now_s, arm.measured, arm.torques.actuator)
        arm.end()

    def _advance_to(self, last: int) -> None:
        """Advance the arm to a tick; those before it are skipped."""
        self.skipped += last - self.ticks - 1
        while self.ticks < last:
            first = self.ticks * self._grid.substeps
            self._arm.advance(first, first + self._grid.substeps)
            self.ticks += 1
            self._arm.read_encoders()
            self._record(self.ticks, self.ticks < last)

"""Handling of faults in a run of the plant: it reports them, stops the arm and ends the run."""

from __future__ import annotations

import logging

from bus_schema.limits import LimitCounts, name_of
from bus_schema.messages.run_event import EventKind
from bus_schema.runtime.clock import TickGrid
from bus_schema.runtime.modes import COMMANDABLE, Mode, mode_event
from plant_emulator.arm_plant import ArmPlant
from plant_emulator.configuration import PlantConfiguration
from plant_emulator.interfaces.interface import Reflex
from plant_emulator.telemetry import PlantTelemetry

logger = logging.getLogger(__name__)


class Supervisor:
    """Stops the arm safely on request, and decides when the run ends.

    Args:
        arm: the arm to stop.
        telemetry: receives events.
        plant: how the arm stops.
        grid: ticks of the run.
        ticks: length of the run.

    Attributes:
        tick: the tick that the run has reached; events are stamped with its instant.
        end_tick: tick at which the run ends: after all its ticks, or when a stop is complete.
        stop_requested: the run must end at the next tick, on request.
        faults: the faults, one sentence each.
        awaited: the peer whose silence was the first fault; empty if it was another.
        limits: how often each limit was hit.
        reflexes: stops that the robot's own controller decided: ``kind``, ``time_s`` and ``joint``,
            None for none.
    """

    def __init__(
        self,
        arm: ArmPlant,
        telemetry: PlantTelemetry,
        plant: PlantConfiguration,
        grid: TickGrid,
        ticks: int,
    ) -> None:
        self._arm, self._telemetry, self._grid = arm, telemetry, grid
        self._safe_stop = f"safe stop ({plant.safe_stop})"
        self._stop_ticks = round(plant.stop_duration_s * 1e9 / grid.period_ns)
        self.tick, self.end_tick = 0, ticks
        self.stop_requested = False
        self.faults: list[str] = []
        self.awaited = ""
        self.limits = LimitCounts()
        self.reflexes: list[dict[str, object]] = []

    def announce(self, kind: EventKind, detail: str) -> None:
        """Report an event at this tick."""
        self._telemetry.note_event(self._grid.tick_ns(self.tick), kind, detail)

    def announce_mode(self, why: str) -> None:
        """Report the arm's current mode."""
        self.announce(EventKind.MODE, mode_event(self._arm.mode, why))

    def fail(self, reason: str, awaited: str = "") -> None:
        """Report a fault; `awaited` is the peer whose silence it is, if it is one."""
        self.awaited = self.awaited if self.faults else awaited
        self.faults.append(reason)
        logger.error("%s", reason)
        self.announce(EventKind.FAULT, reason)

    def stop(self, reason: str) -> None:
        """Stop the arm, and end the run after the stop's duration."""
        self._arm.stop()
        self.announce_mode(self._safe_stop)
        self.fail(reason)
        self.end_tick = min(self.end_tick, self.tick + 1 + self._stop_ticks)

    def stop_safely(self, reason: str) -> None:
        """Stop the arm, and add to the reason that it is stopped safely."""
        self.stop(f"{reason}: {self._safe_stop}")

    def handle_reflex(self, reflex: Reflex) -> None:
        """Stop the arm as its own controller has decided, once."""
        if self._arm.mode is not Mode.TRACKING:
            return
        joint = None if reflex.joint < 0 else self._arm.joint_names[reflex.joint]
        time_s = 1e-9 * self._grid.tick_ns(self.tick)
        self.reflexes.append({"kind": reflex.kind, "time_s": time_s, "joint": joint})
        of_joint = "" if joint is None else f" of {joint}"
        self.stop_safely(f"the robot's reflex {reflex.kind}{of_joint} ({reflex.words})")

    def stop_after_error(self, error: Exception) -> None:
        """Stop the arm because of an error in the loop."""
        reason = f"the plant cannot continue: {type(error).__name__}: {error}"
        logger.exception("the plant cannot continue", exc_info=error)
        if self._arm.mode in COMMANDABLE:
            self.stop_safely(reason)
        else:
            self.fail(reason)

    def handle_limit_hits(self) -> None:
        """Count the limits hit during a tick, and stop the arm if one requires it."""
        hits = self._arm.torques.take_limit_hits()
        new = self.limits.note(hits)
        if new:
            self.announce(EventKind.LIMIT, f"reached for the first time: {name_of(new)}")
        beyond = self._arm.stops_at & hits
        if beyond and self._arm.mode is Mode.TRACKING:
            self.stop_safely(f"beyond its limits: {name_of(beyond)}")

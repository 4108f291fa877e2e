"""What a run of the plant is given, what it passes on, and what comes of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

from bus_schema.arrays import Vector
from bus_schema.link.configuration import LinkConfiguration
from bus_schema.robot_description import RobotDescription
from bus_schema.runtime.clock import TickGrid
from plant_emulator.configuration import PlantConfiguration
from plant_emulator.faults.fault import Fault
from plant_emulator.faults.scheduler import ScheduledAction


class TruthWatch(Protocol):
    """Whoever judges the run looks at the arm's true motion at every tick."""

    def look(self, stamp_ns: int) -> None:
        """A tick is reached, at this instant."""

    def counts(self) -> dict[str, Any]:
        """What was found, ready for JSON."""


@dataclass(frozen=True)
class PlantTask:
    """What the plant has to do.

    Attributes:
        robot: description of the arm.
        plant: section ``plant`` of the scenario.
        link: its section ``link``.
        grid: ticks and physics steps of the run.
        lockstep: wait for the reply to every state that is delivered.
        ticks: length of the run.
        seed: seed of everything random on the link.
        takes_targets: the drives close a loop of their own, around targets that commands bring.
        faults: what breaks, and when.
        process_actions: what is asked for to be done to whole processes, and when.
        watch: makes a watch of the true joint positions, shape (joints,), which change in place.
    """

    robot: RobotDescription
    plant: PlantConfiguration
    link: LinkConfiguration
    grid: TickGrid
    ticks: int
    lockstep: bool
    seed: int
    takes_targets: bool = False
    faults: tuple[Fault, ...] = ()
    process_actions: tuple[ScheduledAction, ...] = ()
    watch: Callable[[Vector], TruthWatch] | None = None


@dataclass
class PlantOutcome:
    """How a run ended.

    Attributes:
        ticks: ticks that passed.
        completed: the run came to its planned end.
        faults: one sentence each.
        wall_s: wall time the loop took.
        stolen_ms: CPU time that a hypervisor gave to others meanwhile.
    """

    ticks: int = 0
    completed: bool = False
    faults: list[str] = field(default_factory=list)
    wall_s: float = 0.0
    stolen_ms: float = 0.0

"""Input and outcome of a run of the plant."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

from bus_schema.arrays import Vector
from bus_schema.link.configuration import LinkConfiguration
from bus_schema.robot_description import RobotDescription
from bus_schema.runtime.clock import TickGrid
from plant_emulator.configuration import PlantConfiguration
from plant_emulator.faults.fault import Fault, ScheduledAction


class TruthWatch(Protocol):
    """Watch of the arm's true motion at every tick, for the judge of the run."""

    def look(self, stamp_ns: int) -> bool:
        """Check the motion at this tick, at this instant; return whether it has ever been lost."""

    def counts(self) -> dict[str, Any]:
        """Return the results, ready for JSON."""


@dataclass(frozen=True)
class PlantTask:
    """The plant's task.

    Attributes:
        robot: description of the arm.
        plant: section ``plant`` of the scenario.
        link: section ``link`` of the scenario.
        grid: ticks and physics steps of the run.
        lockstep: wait for the reply to every state that is delivered.
        answer_every: the controller answers only every so many-th state.
        expected_ns: time after the first state at which its answer will act, if the controller says
            when its commands act; 0 if not.
        ticks: length of the run.
        seed: seed of everything random on the link.
        takes_targets: the drives close their own loop, around targets in the commands.
        faults: the scheduled faults.
        process_actions: actions on whole processes to request, and when.
        watch: creates a watch of the true joint positions, shape (joints,), which change in place.
    """

    robot: RobotDescription
    plant: PlantConfiguration
    link: LinkConfiguration
    grid: TickGrid
    ticks: int
    lockstep: bool
    seed: int
    takes_targets: bool = False
    answer_every: int = 1
    expected_ns: int = 0
    faults: tuple[Fault, ...] = ()
    process_actions: tuple[ScheduledAction, ...] = ()
    watch: Callable[[Vector], TruthWatch] | None = None


@dataclass
class PlantOutcome:
    """Outcome of a run.

    Attributes:
        ticks: ticks that passed.
        completed: the run came to its planned end.
        faults: one sentence each.
        awaited: the peer whose silence was the first of them; empty if it was another.
        wall_s: wall time the loop took.
        stolen_ms: CPU time that the hypervisor gave to others during the run.
    """

    ticks: int = 0
    completed: bool = False
    faults: list[str] = field(default_factory=list)
    awaited: str = ""
    wall_s: float = 0.0
    stolen_ms: float = 0.0

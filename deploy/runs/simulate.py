"""A run in one process and in virtual time: the loops of the bus, on the in-process link."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from bus_schema.link.in_process import InProcessBus, InProcessControllerLink, InProcessPlantLink
from bus_schema.messages.header import stamp_of
from bus_schema.messages.run_event import EventKind, RunEvent
from bus_schema.messages.topics import RUN_EVENTS, Role, Topic
from bus_schema.runtime.clock import VirtualClock
from controller.control_loop import ControlLoop, reason_of
from deploy.processes.recorder import close_log, open_log
from deploy.runs.run_data import RunData, build_run_data
from deploy.runs.simulate_can import run_over_can
from deploy.scenario.scenario import Setup
from deploy.scenario.yaml_files import ScenarioError
from plant_emulator.faults.process_faults import (
    ProcessAction,
    process_actions,
    process_faults,
)
from plant_emulator.plant_loop import PlantLoop

CLOCK = "virtual"
LINK = "in_process"


@dataclass(frozen=True)
class Simulation:
    """A finished simulation.

    Attributes:
        topics: topic of each message that was on the bus, in order.
        payloads: its payload.
        failure: what stopped the controller, if anything did.
    """

    setup: Setup
    topics: list[Topic]
    payloads: list[bytes]
    failure: Exception | None

    def data(self) -> RunData:
        """The data of the run."""
        by_topic: defaultdict[str, list[bytes]] = defaultdict(list)
        for topic, payload in zip(self.topics, self.payloads, strict=True):
            by_topic[topic.name].append(payload)
        return build_run_data(self.setup, by_topic, clock=CLOCK, link=self._link)

    @property
    def _link(self) -> str:
        return "can" if self.setup.scenario.link.kind == "can" else LINK

    def write_log(self, path: Path) -> None:
        """Write the recording that a recorder would have made.

        Raises:
            OSError: the disk does not take it.
        """
        log = open_log(self.setup, path, clock=CLOCK, link=self._link)
        sequences: Counter[str] = Counter()
        for topic, payload in zip(self.topics, self.payloads, strict=True):
            sequences[topic.name] += 1
            stamp_ns = stamp_of(payload) or 0
            log.write(topic, sequences[topic.name], stamp_ns, stamp_ns, payload)
        close_log(log, Counter())
        if log.failure is not None:
            raise log.failure


def simulate(
    setup: Setup,
    on_start: Callable[[PlantLoop], None] | None = None,
    can_log: Path | None = None,
) -> Simulation:
    """Run a scenario in virtual time.

    Args:
        setup: the scenario.
        on_start: called with the plant loop before it runs, to watch its progress or to stop it.
        can_log: file for the frames of a CAN bus.

    Raises:
        ScenarioError: a fault is of a process that is not there.
    """
    _require_simulable(setup)
    clock = VirtualClock()
    bus = InProcessBus(clock)
    if setup.scenario.link.kind == "can":
        stopped_by = run_over_can(setup, bus, clock, on_start, can_log)
        return Simulation(setup, bus.topics, bus.payloads, stopped_by)
    controllers_link = InProcessControllerLink(bus)
    controller = ControlLoop(setup.control_task(), controllers_link)

    def silence(action: ProcessAction) -> None:
        """Silence the controller for good: the plant gives up on it at the first missed reply."""
        if action.verb not in ("resume", "start"):
            controllers_link.close()

    actions = process_actions(setup.scenario.faults, silence)
    task = setup.plant_task(lockstep=True, process_actions=actions)
    arm = setup.arm()
    plant = PlantLoop(task, arm, InProcessPlantLink(bus), clock)
    if on_start is not None:
        on_start(plant)
    try:
        try:
            controller.warm_up()
        except Exception as error:  # noqa: BLE001 (a law of the user's own may raise anything)
            bus.failure = error
            controller.stop(reason_of(error))
        else:
            plant.run()
        controller.end()
    finally:
        arm.close()
    return Simulation(setup, bus.topics, bus.payloads, bus.failure)


def _require_simulable(setup: Setup) -> None:
    for fault in process_faults(setup.scenario.faults):
        if setup.scenario.link.kind == "can":
            raise ScenarioError(
                f"{setup.source}: faults: kind = {fault.kind!r}: must be of another kind for"
                " simulate over CAN; run has processes"
            )
        if Role(fault.target) is not Role.CONTROLLER:
            raise ScenarioError(
                f"{setup.source}: faults: target = {fault.target!r}: must be controller for"
                " simulate, which has no other process; run has"
            )


def attempt(setup: Setup, on_start: Callable[[PlantLoop], None] | None = None) -> Simulation:
    """Simulate; whatever is raised becomes a fault of the run."""
    try:
        return simulate(setup, on_start)
    except Exception as error:  # noqa: BLE001 - a law of the user's own may raise anything
        detail = f"{type(error).__name__}: {error}"
        event = RunEvent(0, Role.CONTROLLER, EventKind.FAULT, detail)
        return Simulation(setup, [RUN_EVENTS], [event.encode()], None)

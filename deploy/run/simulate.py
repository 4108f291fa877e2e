"""A run in one process and in virtual time: the same loops, on links within the process."""

from __future__ import annotations

import pickle
import threading
from collections import Counter, defaultdict
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass, replace
from pathlib import Path

from bus_schema.configuration import ConfigurationError
from bus_schema.link.in_process import InProcessBus
from bus_schema.link.interface import ControllerLink, PlantLink
from bus_schema.messages.run_event import EventKind, RunEvent
from bus_schema.messages.topics import JOINT_STATES, RUN_EVENTS, Role, Topic
from bus_schema.messages.types import stamp_of
from bus_schema.runtime.clock import VirtualClock
from bus_schema.runtime.randomness import noting_draws
from controller.control_loop import ControlLoop, reason_of
from deploy.judge.run_data import RunData, build_run_data
from deploy.run.recording import LoggedView, close_log, open_log
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import naming
from plant_emulator.faults.process_faults import ProcessAction, process_actions, process_faults
from plant_emulator.plant_loop import PlantLoop

CLOCK = "virtual"


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

    def data(self, messages: int | None = None) -> RunData:
        """Return the data of the run.

        Args:
            messages: number of messages in its recording, if any.
        """
        by_topic: defaultdict[str, list[bytes]] = defaultdict(list)
        for topic, payload in zip(self.topics, self.payloads, strict=True):
            by_topic[topic.name].append(payload)
        link = self.setup.link_kind.simulated_as
        data = build_run_data(self.setup, by_topic, clock=CLOCK, link=link)
        return data if messages is None else replace(data, messages=messages)

    def write_log(self, path: Path) -> int:
        """Write the recording that a recorder would have written; return its number of messages.

        Raises:
            OSError: it cannot be written.
        """
        log = open_log(self.setup, path, clock=CLOCK, link=self.setup.link_kind.simulated_as)
        sequences: Counter[str] = Counter()
        view = LoggedView(log, self.setup.robot)
        for topic, payload in zip(self.topics, self.payloads, strict=True):
            sequences[topic.name] += 1
            stamp_ns = stamp_of(payload) or 0
            log.write(topic, sequences[topic.name], stamp_ns, stamp_ns, payload)
            if topic is JOINT_STATES:
                view.show(payload, stamp_ns, stamp_ns)
        close_log(log, Counter(), Counter())
        if log.failure is not None:
            raise log.failure
        return log.messages


@noting_draws()
def simulate(
    setup: Setup, on_start: Callable[[PlantLoop], None] | None = None, can_log: Path | None = None
) -> Simulation:
    """Run a scenario in virtual time.

    Args:
        setup: the scenario.
        on_start: called with the plant loop before it runs, to watch its progress or to stop it.
        can_log: file for the frames of a CAN bus.

    Raises:
        ScenarioError: a fault concerns a process that does not exist.
    """
    require_simulable(setup)
    # A law in this process could write into any array, but not into bytes.
    judged_by = pickle.dumps((setup.funnel, setup.reference))
    clock = VirtualClock()
    bus = InProcessBus(clock)
    run = setup.link_run(lockstep=True, bus=bus, can_log=can_log)
    arm = setup.arm()
    controller_link = setup.link_kind.open_controller(run)
    plant_link = setup.link_kind.open_plant(run, arm, clock)
    controller = ControlLoop(setup.control_task(), controller_link)

    def silence(action: ProcessAction) -> None:
        """Silence the controller for good: the plant gives up at the first missed reply."""
        if action.verb not in ("resume", "start"):
            how = "frozen" if action.verb == "freeze" else "killed"
            bus.controller_loss = f"the controller was {how}"
            controller_link.close()

    actions = process_actions(setup.scenario.faults, silence)
    task = setup.plant_task(lockstep=True, process_actions=actions)
    plant = PlantLoop(task, arm, plant_link, clock)
    if on_start is not None:
        on_start(plant)
    try:
        failure = _warm_up(controller)
        if failure is None:
            timeout_s = run.link.connect_timeout_s
            failure = _run(plant, plant_link, controller, controller_link, timeout_s)
    finally:
        plant_link.close()
        controller_link.close()
        arm.close()
    funnel, reference = pickle.loads(judged_by)
    judged = replace(setup, funnel=funnel, reference=reference)
    return Simulation(judged, bus.topics, bus.payloads, failure)


def _warm_up(controller: ControlLoop) -> Exception | None:
    """Warm the controller up; return the reason if that stopped it for good."""
    try:
        controller.warm_up()
    except Exception as error:  # noqa: BLE001 (a user's law may raise any exception)
        controller.stop(reason_of(error))
        controller.end()
        return error
    return None


def _run(
    plant: PlantLoop,
    plant_link: PlantLink,
    controller: ControlLoop,
    controller_link: ControllerLink,
    timeout_s: float,
) -> Exception | None:
    """Run the plant on this thread, the controller on another; return why that stopped."""
    stop = threading.Event()
    with ThreadPoolExecutor(max_workers=1) as executor:
        failure = executor.submit(
            copy_context().run, _control, controller, controller_link, stop.is_set
        )
        try:
            plant.warm_up()
            plant_link.await_controller(timeout_s, failure.done)
            plant.run()
            plant_link.await_recorded()
        finally:
            plant_link.close()
            stop.set()
    return failure.result()


def _control(
    controller: ControlLoop, link: ControllerLink, is_stop_requested: Callable[[], bool]
) -> Exception | None:
    """Run the controller to the end of the run; return what stopped it, if anything."""
    failure = None
    try:
        link.activate()
        link.spin(is_stop_requested)
    except Exception as error:  # noqa: BLE001 (for any error of a law, the end is in order)
        controller.stop(reason_of(error))
        failure = error
    controller.end()
    link.close()
    return failure


def require_simulable(setup: Setup) -> None:
    """Refuse a scenario with faults of processes that a simulation does not have.

    Raises:
        ScenarioError: the message names the fault.
    """
    with naming(setup.origin):
        for fault in process_faults(setup.scenario.faults):
            if not setup.link_kind.simulates_process_faults:
                allowed = "is not possible in simulate over this link; use run, which has processes"
                raise ConfigurationError("faults: kind", fault.kind, allowed)
            if Role(fault.target) is not Role.CONTROLLER:
                allowed = "must be controller in simulate, which has no other process; use run"
                raise ConfigurationError("faults: target", fault.target, allowed)


def failed_simulation(setup: Setup, detail: str) -> Simulation:
    """Return a run that consists only of a fault of its controller."""
    event = RunEvent(0, Role.CONTROLLER, EventKind.FAULT, detail)
    return Simulation(setup, [RUN_EVENTS], [event.encode()], None)

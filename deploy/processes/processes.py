"""Controller, plant and recorder as processes: signals, progress, end."""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np

from bus_schema.errors import BusError, ScenarioMismatchError
from bus_schema.link.interface import ControllerLink, PlantLink
from bus_schema.messages.topics import Role
from bus_schema.runtime.clock import MonotonicClock, VirtualClock
from bus_schema.runtime.realtime import raise_priority, use_batch_scheduling
from controller.control_law import LOWER, UPPER
from controller.control_loop import ControlLoop, reason_of
from controller.errors import ControllerError
from deploy.exit_codes import BAD_INPUT, FAULT, FINISHED, INTERRUPTED
from deploy.link_kinds.kind import LinkRun
from deploy.processes.live.feed import LiveFeed
from deploy.processes.network.clock_link import ClockLink
from deploy.processes.network.reference_link import ReferenceLink
from deploy.processes.recorder import SCENARIO_ATTACHMENT, Recorder
from deploy.processes.scheduling import (
    leave_loops_their_cpus,
    report_settings,
    set_up_scheduling,
)
from deploy.processes.status import StatusReporter
from deploy.scenario.agreement import agreement_of
from deploy.scenario.setup import Setup
from deploy.stop_signals import ignore_stops, on_stop
from plant_emulator.faults.process_faults import process_actions
from plant_emulator.plant_loop import PlantLoop
from plant_emulator.plant_task import PlantOutcome

logger = logging.getLogger(__name__)

_PROGRESS_S = 0.2
_LONGEST_AWAKE_NS = 60_000
"""Before a tick: some four times what it takes to wake a thread up."""


class StopRequest:
    """Set by a signal to stop; a process looks at it and leaves in order."""

    def __init__(self, then: Callable[[], None] | None = None) -> None:
        self._then = then
        self.is_set = False
        on_stop(self._set)

    def _set(self) -> None:
        self.is_set = True
        if self._then is not None:
            self._then()


def run_plant(
    setup: Setup, reporter: StatusReporter, *, await_recorder: bool, can_log: Path | None = None
) -> int:
    """Be the plant for one run; the exit code."""
    lockstep = setup.scenario.clock == "lockstep"
    arm = setup.arm()
    has_own_cpu = set_up_scheduling(setup, reporter, Role.PLANT)
    awake_ns = min(_LONGEST_AWAKE_NS, setup.grid.period_ns // 10) if has_own_cpu else 0
    clock = VirtualClock() if lockstep else MonotonicClock(awake_ns)
    link = None
    try:
        run = _between_processes(setup, can_log)
        link = setup.link_kind.open_plant(run, arm, clock)
        link = _telling_more(setup, link)
        request = partial(reporter.request, await_execution=lockstep)
        actions = process_actions(setup.scenario.faults, request)
        task = setup.plant_task(lockstep=lockstep, process_actions=actions)
        loop = PlantLoop(task, arm, link, clock)
        loop.warm_up()
        stop = StopRequest(loop.request_stop)
        reporter.report("note", text=f"listening at {setup.scenario.link.plant_endpoint}")
        if await_recorder:
            link.await_recorder(run.link.connect_timeout_s, lambda: stop.is_set)
        link.await_controller(run.link.connect_timeout_s, lambda: stop.is_set)
        with _reporting_progress(reporter, lambda: _plant_progress(loop, setup)):
            outcome = loop.run()
        link.await_recorded()
        if outcome.faults:  # of a controller that left at once, it shows late why
            link.require_same_scenario(Role.CONTROLLER)
        _report_outcome(outcome, reporter)
        if outcome.faults:
            return FAULT
        return INTERRUPTED if stop.is_set else FINISHED
    except BusError as error:
        reporter.report("fault", text=str(error))
        return _exit_code(error)
    finally:
        ignore_stops()
        if link is not None:
            link.close()
        arm.close()


def _telling_more(setup: Setup, link: PlantLink) -> PlantLink:
    """The plant's link with what the scenario wants told beside every state."""
    if setup.scenario.link.publish_reference:
        joint_names = setup.robot.joint_names
        link = cast("PlantLink", ReferenceLink(link, setup.reference, joint_names))
    if setup.scenario.link.publish_clock:
        link = cast("PlantLink", ClockLink(link))
    return link


def _report_outcome(outcome: PlantOutcome, reporter: StatusReporter) -> None:
    for fault in outcome.faults:
        reporter.report("fault", text=fault)
    reporter.report(
        "result", completed=outcome.completed, ticks=outcome.ticks, wall_s=outcome.wall_s
    )


def run_controller(setup: Setup, reporter: StatusReporter, *, await_recorder: bool) -> int:
    """Be the controller for one run; the exit code."""
    stop = StopRequest()
    set_up_scheduling(setup, reporter, Role.CONTROLLER)
    run = _between_processes(setup)
    try:
        link = setup.link_kind.open_controller(run)
    except BusError as error:
        reporter.report("fault", text=str(error))
        return FAULT
    try:
        loop = ControlLoop(setup.control_task(), link)
        failure = _warm_up(loop)
        reporter.report(
            "note", text=f"looking for the plant at {setup.scenario.link.plant_endpoint}"
        )
        if await_recorder:
            link.await_recorder(run.link.connect_timeout_s, lambda: stop.is_set)
        if failure is None:
            link.activate()
            with _reporting_progress(reporter, lambda: _controller_progress(loop)):
                failure = _spin(link, stop)
        _end(loop, link, failure, reporter)
        if failure is not None:
            return _exit_code(failure)
        return INTERRUPTED if stop.is_set else FINISHED
    except BusError as error:
        reporter.report("fault", text=str(error))
        return _exit_code(error)
    finally:
        ignore_stops()
        link.close()


def _warm_up(loop: ControlLoop) -> Exception | None:
    """Make the controller ready; what kept it from that, if anything did."""
    try:
        loop.warm_up()
    except Exception as error:  # noqa: BLE001 (whatever a law does, the end is in order)
        return error
    return None


def _spin(link: ControllerLink, stop: StopRequest) -> Exception | None:
    """Answer states to the end; what stopped that, if anything did."""
    try:
        link.spin(lambda: stop.is_set)
    except Exception as error:  # noqa: BLE001 (whatever a law does, the end is in order)
        return error
    return None


def _end(
    loop: ControlLoop, link: ControllerLink, failure: Exception | None, reporter: StatusReporter
) -> None:
    """Leave the bus in order, and report what stopped the controller, if anything did."""
    if failure is not None:
        reason = reason_of(failure)
        # What the controller does is a cause; what the bus does may follow from others.
        bus_is_cause = isinstance(failure, BusError) and failure.is_cause
        is_cause = bus_is_cause or isinstance(failure, ControllerError)
        reporter.report("fault", text=reason, is_cause=is_cause)
        loop.stop(reason)
    reporter.report("result", **loop.end())
    link.await_recorded()


def run_recorder(setup: Setup, path: Path, reporter: StatusReporter, stop: StopRequest) -> int:
    """Be the recorder for one run, and feed live views of it; the exit code."""
    leave_loops_their_cpus()
    if setup.scenario.clock == "realtime":
        report_settings([raise_priority()], reporter)
    else:
        use_batch_scheduling()
    feed = _live_feed(setup, path)
    try:
        recorder = Recorder(setup, path, feed)
    except (BusError, OSError) as error:
        reporter.report("fault", text=f"{path}: {error}")
        if feed is not None:
            feed.close()
        return FAULT
    reporter.report("note", text=f"recording to {path}")
    code = FINISHED
    try:
        recorder.run(lambda: stop.is_set)
    except BusError as error:
        reporter.report("fault", text=str(error))
        code = _exit_code(error)
    ignore_stops()
    recorder.close()
    if feed is not None:
        feed.close()
    if recorder.failure is not None:
        reporter.report(
            "fault", text=f"{path}: the recording is partial: {recorder.failure.strerror}"
        )
        code = FAULT
    lost = recorder.lost
    by_topic = "".join(f", {topic} {count}" for topic, count in lost.items())
    reporter.report(
        "note", text=f"{recorder.messages} messages recorded, {lost.total()} lost{by_topic}"
    )
    return code


def _live_feed(setup: Setup, recording: Path) -> LiveFeed | None:
    """Where live views find the run; None where there is no place for it, which costs no run."""
    scenario = recording.resolve().with_name(SCENARIO_ATTACHMENT)
    try:
        return LiveFeed(setup.scenario.link.plant_endpoint, scenario, setup.robot.joint_names)
    except OSError as error:
        logger.warning("there will be no live view: %s", error)
        return None


def _between_processes(setup: Setup, can_log: Path | None = None) -> LinkRun:
    run = setup.link_run(lockstep=setup.scenario.clock == "lockstep", can_log=can_log)
    return replace(run, agreement=agreement_of(setup))


def _exit_code(error: Exception) -> int:
    """Different scenarios are bad input, though it shows only once both are there."""
    return BAD_INPUT if isinstance(error, ScenarioMismatchError) else FAULT


@contextlib.contextmanager
def _reporting_progress(
    reporter: StatusReporter, progress: Callable[[], dict[str, Any]]
) -> Iterator[None]:
    """Report how the loop is doing a few times a second, from outside the loop."""
    over = threading.Event()

    def report() -> None:
        while not over.wait(_PROGRESS_S):
            reporter.report("progress", **progress())

    thread = threading.Thread(target=report, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def _plant_progress(loop: PlantLoop, setup: Setup) -> dict[str, Any]:
    time_s = setup.grid.tick_ns(loop.tick) * 1e-9
    return {"time_s": round(time_s, 3), "deadline_misses": loop.deadline_misses}


def _controller_progress(loop: ControlLoop) -> dict[str, Any]:
    if not loop.cycles:
        return {}
    tracking = loop.tracking
    bounds = np.where(tracking.error >= 0.0, tracking.bounds[UPPER], tracking.bounds[LOWER])
    joint = int(np.argmax(np.abs(tracking.error) / np.maximum(bounds, 1e-12)))
    return {
        "joint": joint + 1,
        "error_mrad": round(1e3 * float(tracking.error[joint]), 4),
        "bound_mrad": round(1e3 * float(bounds[joint]), 3),
    }

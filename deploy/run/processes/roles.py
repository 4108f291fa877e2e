"""The functions of a run's processes: controller, plant, recorder."""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bus_schema.errors import BusError, ScenarioMismatchError
from bus_schema.link.interface import ControllerLink
from bus_schema.messages.topics import Role
from bus_schema.runtime.clock import MonotonicClock, VirtualClock
from bus_schema.runtime.randomness import noting_draws
from bus_schema.runtime.realtime import raise_priority, use_batch_scheduling
from controller.control_law import LOWER, UPPER
from controller.control_loop import ControlLoop, reason_of
from controller.errors import ControllerError
from controller.policies.served_law import ServedLaw
from deploy.run.exit_codes import BAD_INPUT, FAULT, FINISHED, INTERRUPTED
from deploy.run.network.links import check_link, require_keys, require_own_controller
from deploy.run.network.live_feed import LiveFeed
from deploy.run.network.more_topics import with_clock, with_reference
from deploy.run.processes.recorder import Recorder
from deploy.run.processes.scheduling import (
    leave_loops_their_cpus,
    report_settings,
    set_up_scheduling,
)
from deploy.run.processes.status import StatusReporter
from deploy.run.recording import SCENARIO_ATTACHMENT
from deploy.run.stop_signals import StopRequest, ignore_stops
from deploy.scenario.effective import agreement_of
from deploy.scenario.link_kinds.kind import LinkRun
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from plant_emulator.faults.process_faults import process_actions
from plant_emulator.plant_loop import PlantLoop
from plant_emulator.plant_task import PlantOutcome

logger = logging.getLogger(__name__)

_PROGRESS_S = 0.2
_LONGEST_AWAKE_NS = 60_000
"""Time spent awake before a tick: about four times a thread's wake-up time."""


@dataclass(frozen=True)
class RoleOptions:
    """Options of controller, plant or recorder.

    Attributes:
        scenario: name or path.
        overrides: ``key=value`` each.
        await_recorder: start only once a recorder listens.
        log: file for the recording; of a plant, for the frames of a CAN bus, or None.
        run_key: key of the run, by which the others know its recorder; empty if none did start it.
    """

    scenario: str
    overrides: Sequence[str] = ()
    await_recorder: bool = False
    log: Path | None = None
    run_key: str = ""


@noting_draws()
def plant(options: RoleOptions, reporter: StatusReporter) -> int:
    """Run the plant: emulate the arm for a controller on the bus; return the exit code."""
    setup = load_setup(options.scenario, options.overrides)
    check_link(setup, one_process=False)
    require_keys(setup, Role.PLANT)
    lockstep = setup.scenario.clock == "lockstep"
    arm = setup.arm()
    has_own_cpu = set_up_scheduling(setup, reporter, Role.PLANT)
    awake_ns = min(_LONGEST_AWAKE_NS, setup.grid.period_ns // 10) if has_own_cpu else 0
    clock = VirtualClock() if lockstep else MonotonicClock(awake_ns)
    link = None
    try:
        run = _between_processes(setup, options, options.log)
        link = setup.link_kind.open_plant(run, arm, clock)
        if setup.scenario.link.publish_reference:
            link = with_reference(link, setup.reference, setup.robot.joint_names)
        if setup.scenario.link.publish_clock:
            link = with_clock(link)
        request = partial(reporter.request, await_execution=lockstep)
        actions = process_actions(setup.scenario.faults, request)
        task = setup.plant_task(lockstep=lockstep, process_actions=actions)
        loop = PlantLoop(task, arm, link, clock)
        loop.warm_up()
        stop = StopRequest(loop.request_stop)
        reporter.report("note", text=f"listening at {setup.scenario.link.plant_endpoint}")
        if options.await_recorder:
            link.await_recorder(run.link.connect_timeout_s, lambda: stop.is_set)
        link.await_controller(run.link.connect_timeout_s, lambda: stop.is_set)
        with _reporting_progress(reporter, lambda: _plant_progress(loop, setup)):
            outcome = loop.run()
        link.await_recorded()
        if outcome.faults:  # a controller that left at once explains it late
            link.require_same_scenario(Role.CONTROLLER)
        _report_outcome(outcome, reporter)
        if outcome.faults:
            return FAULT
        return INTERRUPTED if stop.is_set else FINISHED
    except BusError as error:
        reporter.report("fault", text=str(error), awaited=error.peer)
        return _exit_code(error)
    finally:
        ignore_stops()
        if link is not None:
            link.close()
        arm.close()


def _report_outcome(outcome: PlantOutcome, reporter: StatusReporter) -> None:
    for fault in outcome.faults:
        reporter.report("fault", text=fault, awaited=outcome.awaited)
    reporter.report(
        "result", completed=outcome.completed, ticks=outcome.ticks, wall_s=outcome.wall_s
    )


@noting_draws()
def controller(options: RoleOptions, reporter: StatusReporter) -> int:
    """Run the controller: answer the joint states of a plant on the bus; return the exit code."""
    setup = load_setup(options.scenario, options.overrides)
    check_link(setup, one_process=False)
    require_own_controller(setup)
    require_keys(setup, Role.CONTROLLER)
    stop = StopRequest()
    set_up_scheduling(setup, reporter, Role.CONTROLLER)
    run = _between_processes(setup, options)
    link = None
    try:
        link = setup.link_kind.open_controller(run)
        task = setup.control_task()
        if setup.scenario.clock == "realtime" and isinstance(task.law, ServedLaw):
            task.law.answer_in_real_time()
        loop = ControlLoop(task, link)
        failure = _failure_of(loop.warm_up)
        reporter.report(
            "note", text=f"looking for the plant at {setup.scenario.link.plant_endpoint}"
        )
        if options.await_recorder:
            link.await_recorder(run.link.connect_timeout_s, lambda: stop.is_set)
        if failure is None:
            link.activate()
            with _reporting_progress(reporter, lambda: _controller_progress(loop)):
                failure = _failure_of(partial(link.spin, lambda: stop.is_set))
        _end(loop, link, failure, reporter)
        if failure is not None:
            return _exit_code(failure)
        return INTERRUPTED if stop.is_set else FINISHED
    except BusError as error:
        reporter.report("fault", text=str(error), awaited=error.peer)
        return _exit_code(error)
    finally:
        ignore_stops()
        if link is not None:
            link.close()


def _failure_of(step: Callable[[], None]) -> Exception | None:
    """Do a step that calls a law; return its exception, if any."""
    try:
        step()
    except Exception as error:  # noqa: BLE001 (for any error of a law, the end is in order)
        return error
    return None


def _end(
    loop: ControlLoop, link: ControllerLink, failure: Exception | None, reporter: StatusReporter
) -> None:
    """Leave the bus in order, and report the reason if the controller was stopped."""
    if failure is not None:
        reason = reason_of(failure)
        # The controller's own failures are causes; those of the bus may be consequences.
        of_bus = failure if isinstance(failure, BusError) else BusError()
        is_cause = of_bus.is_cause or isinstance(failure, ControllerError)
        reporter.report("fault", text=reason, is_cause=is_cause, awaited=of_bus.peer)
        loop.stop(reason)
    reporter.report("result", **loop.end())
    link.await_recorded()


def recorder(options: RoleOptions, reporter: StatusReporter) -> int:
    """Run the recorder: write every message on the bus to a file; return the exit code."""
    setup = load_setup(options.scenario, options.overrides)
    require_keys(setup, Role.RECORDER)
    assert options.log is not None  # the file
    return run_recorder(setup, options.log, reporter, StopRequest(), options.run_key)


def run_recorder(
    setup: Setup, path: Path, reporter: StatusReporter, stop: StopRequest, run_key: str = ""
) -> int:
    """Run the recorder for one run, and feed its live views; return the exit code."""
    leave_loops_their_cpus()
    if setup.scenario.clock == "realtime":
        report_settings([raise_priority()], reporter)
    else:
        use_batch_scheduling()
    feed = _live_feed(setup, path)
    try:
        recorder = Recorder(setup, path, feed, run_key)
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
        reporter.report("fault", text=str(error), awaited=error.peer)
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


ROLES = {Role.CONTROLLER: controller, Role.PLANT: plant, Role.RECORDER: recorder}


def _live_feed(setup: Setup, recording: Path) -> LiveFeed | None:
    """Return the feed of live views; None if its socket cannot be created, which fails no run."""
    scenario = recording.resolve().with_name(SCENARIO_ATTACHMENT)
    try:
        return LiveFeed(setup.scenario.link.plant_endpoint, scenario, setup.robot.joint_names)
    except OSError as error:
        logger.warning("no live view: %s", error)
        return None


def _between_processes(setup: Setup, options: RoleOptions, can_log: Path | None = None) -> LinkRun:
    run = setup.link_run(lockstep=setup.scenario.clock == "lockstep", can_log=can_log)
    return replace(run, agreement=agreement_of(setup, options.run_key))


def _exit_code(error: Exception) -> int:
    """Return the exit code: a mismatch of scenarios is bad input, even if found late."""
    return BAD_INPUT if isinstance(error, ScenarioMismatchError) else FAULT


@contextlib.contextmanager
def _reporting_progress(
    reporter: StatusReporter, progress: Callable[[], dict[str, Any]]
) -> Iterator[None]:
    """Report the loop's progress a few times a second, from outside the loop."""
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
    return {"time_s": round(time_s, 3), "late_ticks": loop.late_ticks}


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

"""The commands `run` and `simulate`."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import typer

from bus_schema.messages.topics import Role
from controller.laws.custom import custom_laws_left_out
from deploy.cli.parts.common import ResultGate, finish, say_warnings, watching
from deploy.cli.parts.options import RunOptions, SimulateOptions
from deploy.cli.parts.progress import CommandProgress
from deploy.cli.parts.watched import run_watched
from deploy.cli.show_run import show_relay, status_handler
from deploy.judge.tested_with import tested_with
from deploy.reports.results import load_report
from deploy.run.confirmation import check_confirmable, check_repeatable, simulated_otherwise
from deploy.run.console import Console
from deploy.run.execute import InProcess, InProcesses, execute, recorded
from deploy.run.network.links import check_awaiting, check_link, require_keys, with_free_endpoints
from deploy.run.network.real_delay import (
    RealDelay,
    check_real_delay,
    knowing_real_delay,
    real_delay,
)
from deploy.run.processes.child import RunOutcome
from deploy.run.processes.program import require_program
from deploy.run.processes.status import StatusMessage, StatusReporter
from deploy.run.recording import record_failures
from deploy.run.run_folder import RunFolder
from deploy.run.simulate import require_simulable
from deploy.run.stop_signals import on_stop, stop_at_once
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.study.study import OF_BOUND


def run_in_processes(options: RunOptions) -> None:
    """Run controller, plant and recorder as processes, and report whether bounds were kept."""
    as_given = _checked(options)
    awaits_controller = options.await_controller
    setup = as_given if awaits_controller else with_free_endpoints(as_given)
    delay = None if options.real_delay_ms is None else real_delay(setup, options.real_delay_ms)
    console = Console()
    with RunFolder.begin(setup, options.out, overwrite=options.overwrite) as folder:
        with _progress(console, setup) as progress:
            if awaits_controller:
                progress.say(_waiting_sentence(setup, delay))
            show = status_handler(progress, setup.robot.joint_names)
            how = InProcesses(
                delay, awaits_controller=awaits_controller, viewer=_view if options.live else None,
                on_start=on_stop, on_message=show if options.no_report else loading_report(show),
            )  # fmt: skip
            run = execute(setup, how, folder)
        outcome = run.outcome
        folder.write_scenario(as_given)
        if delay is not None:
            show_relay(console, outcome.relay)
        if options.confirm and not outcome.interrupted:
            alarms = simulated_otherwise(as_given, folder.path)
            outcome.failures += alarms
            record_failures(folder.log, outcome.failures if alarms else ())
        finish(console, folder, run, options)


def _progress(console: Console, setup: Setup) -> CommandProgress:
    return CommandProgress(console, setup.scenario.name, setup.scenario.duration_s, "s")


def _view(folder: Path, reporter: StatusReporter) -> int:
    """Show the run in the viewer's process, which alone loads the viewer. Returns its code."""
    from deploy.cli.view import view_beside

    return view_beside(folder, reporter)


def _checked(options: RunOptions) -> Setup:
    """Return the scenario after checking that it can run in processes."""
    setup = load_setup(options.scenario, options.overrides or [])
    say_warnings(setup)
    if options.real_delay_ms is not None:
        check_real_delay(setup, options.real_delay_ms)
        setup = knowing_real_delay(setup, options.real_delay_ms)
    check_link(setup, one_process=False)
    if options.confirm:
        check_repeatable(setup)
    require_program(setup)
    require_keys(setup, *Role)
    if options.await_controller:
        check_awaiting(setup)
    return setup


def loading_report(on_message: Callable[[StatusMessage], None]) -> Callable[[StatusMessage], None]:
    """Return a handler that also loads the report modules when the plant has finished.

    Earlier, loading would take CPU time from the measured loops. Later, the user would wait for it.
    """
    loading = threading.Thread(target=load_report, daemon=True)

    def handle(message: StatusMessage) -> None:
        if message.kind == "result" and message.role == Role.PLANT and loading.ident is None:
            loading.start()
        on_message(message)

    return handle


def _waiting_sentence(setup: Setup, delay: RealDelay | None) -> str:
    """Say where an external controller finds the plant, and the recorder the controller."""
    link = setup.scenario.link
    place = link.plant_endpoint if delay is None else delay.endpoint
    return (
        f"waiting up to {link.connect_timeout_s:g} s for a controller: the plant is at {place}, and"
        f" the recorder looks for the controller at {link.controller_endpoint}"
    )


def run_in_virtual_time(options: SimulateOptions) -> None:
    """Run a scenario in virtual time, in a child process, and judge its recording in this one.

    A custom law shares its process with nothing that judges it.
    """
    with custom_laws_left_out():
        setup = load_setup(options.scenario, options.overrides or [])
    tested = tested_with([setup], {"seeds": [setup.scenario.seed]})
    gate = ResultGate(options, setup.scenario.name, OF_BOUND, tested)
    console, stop = Console(), threading.Event()
    on_stop(stop.set)
    left = run_watched(partial(_simulated, options, console, stop))
    outcome = RunOutcome(left["failures"], interrupted=left["interrupted"] or stop.is_set())
    with RunFolder(Path(left["folder"])).lock() as folder:
        run, confirms = (
            recorded(folder, outcome, setup),
            options.confirm and not outcome.interrupted,
        )
        finish(console, folder, run, options, confirms=confirms, gate=gate)


def _simulated(options: SimulateOptions, console: Console, stop: threading.Event) -> dict[str, Any]:
    """Run and record; return the folder, what failed, and whether the user stopped it."""
    stop_at_once()
    setup = load_setup(options.scenario, options.overrides or [])
    say_warnings(setup)
    if setup.scenario.link.security.enabled:
        typer.echo("warning: link.security: a simulation neither uses nor checks keys", err=True)
    check_link(setup, one_process=True)
    require_simulable(setup)
    if options.confirm:
        check_confirmable(setup)
    failures = []
    folder = RunFolder.begin(setup, options.out, overwrite=options.overwrite)
    with folder, _progress(console, setup) as progress:
        watch = watching(progress, setup, setup.scenario.name, stop)
        try:
            execute(setup, InProcess(watch, partial(on_stop, stop.set)), folder)
        except OSError as error:
            failures.append(f"{folder.log}: the recording is partial: {error.strerror}")
    return {"folder": str(folder.path), "failures": failures, "interrupted": stop.is_set()}

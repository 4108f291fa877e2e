"""The command line: `funnel-hil`."""

from __future__ import annotations

import logging
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape

from bus_schema.topics import Role
from bus_schema.whole_files import partial_path
from deploy import cli_drives, cli_experiments, cli_keys, cli_studies
from deploy import doctor as doctor_module
from deploy.cli_common import (
    BAD_INPUT,
    BOUNDS_NOT_KEPT,
    FAULT,
    FINISHED,
    INTERRUPTED,
    Out,
    Overrides,
    RequireBounds,
    ScenarioArgument,
    on_interrupt,
)
from deploy.experiments.simulate import simulate as simulate_setup
from deploy.keys import check_keys
from deploy.launcher import Launcher, RunOutcome, with_free_endpoints
from deploy.links import check_link
from deploy.processes import StopRequest, Voice, run_controller, run_plant, run_recorder
from deploy.run_folder import RunFolder, RunFolderError, load_run
from deploy.scenario import Setup, load_setup
from deploy.terminal import RunProgress, show_summary
from deploy.yaml_files import ScenarioError
from plant_emulator.plant_loop import PlantLoop

_SIMULATE_POLL_S = 0.1

app = typer.Typer(
    help="Hardware-in-the-loop test bench for prescribed-performance robot control.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

ToParent = Annotated[bool, typer.Option("--to-parent", hidden=True)]
AwaitRecorder = Annotated[
    bool, typer.Option("--await-recorder", help="Start only once a recorder listens.")
]


@app.command()
def run(
    scenario: ScenarioArgument = "paper_arm",
    overrides: Overrides = None,
    out: Out = None,
    require_bounds: RequireBounds = False,
) -> None:
    """Run controller, plant and recorder as separate processes, and judge the run."""
    setup = load_setup(scenario, with_free_endpoints(overrides or []))
    check_link(setup, one_process=False)
    _require_keys(setup, *Role)
    console = Console()
    folder = RunFolder.create(setup.scenario.name, out)
    folder.write_scenario(setup)
    folder.write_manifest(setup, {})
    launcher = Launcher(setup, folder)
    on_interrupt(launcher.request_stop)
    with RunProgress(console, setup.scenario.name, setup.scenario.duration_s) as progress:
        outcome = launcher.run(progress.hear)
    folder.write_manifest(setup, outcome.grants)
    _finish(console, folder, outcome, require_bounds=require_bounds)


@app.command()
def simulate(
    scenario: ScenarioArgument = "paper_arm",
    overrides: Overrides = None,
    out: Out = None,
    require_bounds: RequireBounds = False,
) -> None:
    """Run a scenario in one process and in virtual time."""
    setup = load_setup(scenario, overrides or [])
    check_link(setup, one_process=True)
    console = Console()
    folder = RunFolder.create(setup.scenario.name, out)
    folder.write_scenario(setup)
    folder.write_manifest(setup, {})
    outcome = RunOutcome()
    over = threading.Event()

    with RunProgress(console, setup.scenario.name, setup.scenario.duration_s) as progress:

        def watch(loop: PlantLoop) -> None:
            def stop() -> None:
                outcome.interrupted = True
                loop.request_stop()

            on_interrupt(stop)
            _every(
                _SIMULATE_POLL_S, over, lambda: progress.at(setup.grid.tick_ns(loop.tick) * 1e-9)
            )

        try:
            simulation = simulate_setup(setup, watch, folder.can_log)
        finally:
            over.set()
    simulation.write_log(folder.log)
    _finish(console, folder, outcome, require_bounds=require_bounds)


@app.command()
def controller(
    scenario: ScenarioArgument,
    overrides: Overrides = None,
    await_recorder: AwaitRecorder = False,
    to_parent: ToParent = False,
) -> None:
    """Be the controller: answer the joint states of a plant on the bus."""
    setup = load_setup(scenario, overrides or [])
    check_link(setup, one_process=False)
    _require_keys(setup, Role.CONTROLLER)
    voice = Voice(Role.CONTROLLER, to_parent=to_parent)
    raise typer.Exit(run_controller(setup, voice, await_recorder=await_recorder))


@app.command()
def plant(
    scenario: ScenarioArgument,
    overrides: Overrides = None,
    await_recorder: AwaitRecorder = False,
    can_log: Annotated[
        Path | None, typer.Option("--can-log", help="File for the frames of a CAN bus.")
    ] = None,
    to_parent: ToParent = False,
) -> None:
    """Be the plant: emulate the arm for a controller on the bus."""
    setup = load_setup(scenario, overrides or [])
    check_link(setup, one_process=False)
    _require_keys(setup, Role.PLANT)
    voice = Voice(Role.PLANT, to_parent=to_parent)
    raise typer.Exit(run_plant(setup, voice, await_recorder=await_recorder, can_log=can_log))


@app.command()
def record(
    scenario: ScenarioArgument,
    overrides: Overrides = None,
    out: Out = None,
    log: Annotated[Path | None, typer.Option("--log", hidden=True)] = None,
    to_parent: ToParent = False,
) -> None:
    """Be the recorder: write every message on the bus to a run folder."""
    setup = load_setup(scenario, overrides or [])
    _require_keys(setup, Role.RECORDER)
    voice = Voice(Role.RECORDER, to_parent=to_parent)
    stop = StopRequest()
    if log is not None:
        raise typer.Exit(run_recorder(setup, log, voice, stop))
    folder = RunFolder.create(setup.scenario.name, out)
    folder.write_scenario(setup)
    folder.write_manifest(setup, {})
    code = run_recorder(setup, folder.log, voice, stop)
    if code == FINISHED or partial_path(folder.log).exists():
        outcome = RunOutcome(interrupted=stop.is_set)
        _finish(Console(), folder, outcome, require_bounds=False)
    raise typer.Exit(code)


app.add_typer(cli_keys.app, name="keys")
for _command in (
    cli_experiments.compare,
    cli_studies.sweep,
    cli_studies.margin,
    cli_experiments.report,
    cli_experiments.replay,
    cli_experiments.bench,
    cli_drives.drives,
):
    app.command()(_command)


@app.command()
def doctor() -> None:
    """Say what this machine grants, and what each missing thing costs."""
    doctor_module.show(doctor_module.examine(), Console())


def main() -> None:
    """Entry point; bad input ends here with one message and exit code 2."""
    logging.basicConfig(level=logging.ERROR, format="%(message)s", stream=sys.stderr)
    logging.getLogger("bus_schema").setLevel(logging.WARNING)
    logging.getLogger("plant_emulator").setLevel(logging.CRITICAL)
    try:
        app()
    except (ScenarioError, RunFolderError) as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(BAD_INPUT)
    except OSError as error:  # a disk that is full or gone
        print(f"error: {error}", file=sys.stderr)
        sys.exit(FAULT)


def _require_keys(setup: Setup, *roles: Role) -> None:
    """Bad keys are bad input, told before anything starts."""
    security = setup.scenario.link.security
    if security.enabled:
        check_keys(security.keys, roles)


def _finish(
    console: Console, folder: RunFolder, outcome: RunOutcome, *, require_bounds: bool
) -> None:
    """Judge a run, show the result, and leave with the exit code it deserves."""
    try:
        data, _ = load_run(folder.path)
    except RunFolderError as error:
        faults = [] if outcome.interrupted else [*outcome.failures, str(error)]
        for fault in faults or ["stopped before the run began"]:
            console.print(escape(fault))
        folder.write_summary({"completed": False, "faults": faults})
        raise typer.Exit(INTERRUPTED if outcome.interrupted else FAULT) from error
    summary = folder.conclude(data, outcome.failures)
    show_summary(console, summary)
    console.print(f"results: {folder.path}", soft_wrap=True)
    console.print(f"report:  {folder.report}", soft_wrap=True)
    raise typer.Exit(_exit_code(summary, outcome, require_bounds=require_bounds))


def _exit_code(summary: dict[str, Any], outcome: RunOutcome, *, require_bounds: bool) -> int:
    if outcome.interrupted:
        return INTERRUPTED
    if summary["faults"] or not summary["completed"]:
        return FAULT
    if require_bounds and not summary["bounds"]["kept"]:
        return BOUNDS_NOT_KEPT
    return FINISHED


def _every(seconds: float, over: threading.Event, action: Callable[[], None]) -> None:
    """Do something again and again on a thread of its own, until `over`."""

    def repeat() -> None:
        while not over.wait(seconds):
            action()

    threading.Thread(target=repeat, daemon=True).start()


if __name__ == "__main__":
    main()

"""One run: `funnel-hil run` in three processes, `funnel-hil simulate` in this one."""

from __future__ import annotations

import threading
from typing import Annotated

import typer
from rich.console import Console

from bus_schema.messages.topics import Role
from deploy.cli.common import (
    NoReport,
    Out,
    Overrides,
    Overwrite,
    RequireBounds,
    ScenarioArgument,
    finish,
    say_oddities,
    watching,
)
from deploy.cli.terminal.progress import CommandProgress
from deploy.cli.terminal.show_run import show_relay, status_handler
from deploy.processes.launcher import Launcher, RunOutcome
from deploy.processes.network.links import (
    check_awaiting,
    check_link,
    require_keys,
    with_free_endpoints,
)
from deploy.processes.network.real_delay import (
    RealDelay,
    check_real_delay,
    knowing_real_delay,
    real_delay,
)
from deploy.processes.program import require_program
from deploy.runs.run_folder import RunFolder
from deploy.runs.simulate import simulate as simulate_setup
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.stop_signals import on_stop

RealDelayOption = Annotated[
    float | None,
    typer.Option(
        "--real-delay",
        metavar="MS",
        help="Have a relay between controller and plant hold every byte back: the round trip, half"
        " of it each way.",
    ),
]

AwaitController = Annotated[
    bool,
    typer.Option(
        "--await-controller",
        help="Start plant and recorder only, and wait for a controller that is started elsewhere:"
        " for link.connect_timeout_s, at the endpoints of the scenario.",
    ),
]

Live = Annotated[
    bool,
    typer.Option("--live", help="Show the run in the browser and in Foxglove while it happens."),
]


def run(
    scenario: ScenarioArgument = "paper_arm",
    overrides: Overrides = None,
    out: Out = None,
    overwrite: Overwrite = False,
    require_bounds: RequireBounds = False,
    no_report: NoReport = False,
    real_delay_ms: RealDelayOption = None,
    await_controller: AwaitController = False,
    live: Live = False,
) -> None:
    """Run controller, plant and recorder as separate processes, and judge the run."""
    setup = load_setup(scenario, overrides or [])
    say_oddities(setup)
    if real_delay_ms is not None:
        check_real_delay(setup, real_delay_ms)
        setup = knowing_real_delay(setup, real_delay_ms)
    check_link(setup, one_process=False)
    require_program(setup)
    require_keys(setup, *Role)
    as_given = setup
    if await_controller:
        check_awaiting(setup)
    else:
        setup = with_free_endpoints(setup)
    delay = None if real_delay_ms is None else real_delay(setup, real_delay_ms)
    console = Console()
    folder = RunFolder.begin(setup, out, overwrite=overwrite)
    with folder:
        launcher = Launcher(
            setup, scenario=folder.scenario, log=folder.log, can_log=folder.can_log, delay=delay,
            awaits_controller=await_controller, live=live,
        )  # fmt: skip
        on_stop(launcher.request_stop)
        with CommandProgress(
            console, setup.scenario.name, setup.scenario.duration_s, "s"
        ) as progress:
            if await_controller:
                progress.say(waiting_sentence(setup, delay))
            outcome = launcher.run(status_handler(progress, setup.robot.joint_names))
        held_back = None if delay is None else {"round_trip_ms": real_delay_ms, **outcome.relay}
        folder.write_manifest(setup, outcome.realtime, held_back)
        folder.write_scenario(as_given)
        if held_back is not None:
            show_relay(console, held_back)
        finish(console, folder, outcome, require_bounds=require_bounds, draws_report=not no_report)


def waiting_sentence(setup: Setup, delay: RealDelay | None) -> str:
    """Where a controller from elsewhere finds the plant, and the recorder finds it."""
    link = setup.scenario.link
    place = link.plant_endpoint if delay is None else delay.endpoint
    return (
        f"waiting for a controller, {link.connect_timeout_s:g} s: the plant is at {place}, and the"
        f" recorder looks for the controller at {link.controller_endpoint}"
    )


def simulate(
    scenario: ScenarioArgument = "paper_arm",
    overrides: Overrides = None,
    out: Out = None,
    overwrite: Overwrite = False,
    require_bounds: RequireBounds = False,
    no_report: NoReport = False,
) -> None:
    """Run a scenario in one process and in virtual time."""
    setup = load_setup(scenario, overrides or [])
    say_oddities(setup)
    check_link(setup, one_process=True)
    console = Console()
    folder = RunFolder.begin(setup, out, overwrite=overwrite)
    with folder:
        name, stop = setup.scenario.name, threading.Event()
        with CommandProgress(console, name, setup.scenario.duration_s, "s") as progress:
            watch = watching(progress, setup, name, stop)
            simulation = simulate_setup(setup, watch, folder.can_log)
        data = simulation.data(simulation.write_log(folder.log))
        outcome = RunOutcome(interrupted=stop.is_set())
        finish(
            console, folder, outcome,
            data=data, require_bounds=require_bounds, draws_report=not no_report,
        )  # fmt: skip

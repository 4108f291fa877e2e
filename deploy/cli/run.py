"""One run: `funnel-hil run` in three processes, `funnel-hil simulate` in this one.

What they do is in `one_run.py`, which loads all of the program: help and errors of the command line
need none of it, and what the processes of a run are forked from loads it at the same time.
"""

from __future__ import annotations

from typing import Annotated

import typer

from deploy.cli.options import (
    Confirm,
    NoReport,
    Out,
    Overrides,
    Overwrite,
    RequireBounds,
    RunOptions,
    ScenarioArgument,
)

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


ConfirmInOneProcess = Annotated[
    bool,
    typer.Option(
        "--confirm",
        help="With clock=lockstep: simulate the run again in one process; another digest or verdict"
        " is a fault.",
    ),
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
    confirm: ConfirmInOneProcess = False,
) -> None:
    """Run controller, plant and recorder as separate processes, and judge the run."""
    from deploy.run.processes.role_process import prepare  # help and errors need none of it

    prepare()
    from deploy.cli.one_run import run_in_processes

    options = RunOptions(
        scenario, overrides or [], out, overwrite, require_bounds, not no_report, confirm
    )
    run_in_processes(
        options, real_delay_ms=real_delay_ms, await_controller=await_controller, live=live
    )


def simulate(
    scenario: ScenarioArgument = "paper_arm",
    overrides: Overrides = None,
    out: Out = None,
    overwrite: Overwrite = False,
    require_bounds: RequireBounds = False,
    no_report: NoReport = False,
    confirm: Confirm = False,
) -> None:
    """Run a scenario in one process and in virtual time."""
    from deploy.cli.one_run import run_in_virtual_time

    run_in_virtual_time(
        RunOptions(
            scenario, overrides or [], out, overwrite, require_bounds, not no_report, confirm
        )
    )

"""The commands that are one process of a run: `controller`, `plant`, `record` and `relay`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from bus_schema.messages.topics import Role
from bus_schema.recording.atomic_files import partial_path
from deploy.cli.common import finish
from deploy.cli.options import Out, Overrides, Overwrite, ScenarioArgument
from deploy.exit_codes import FINISHED
from deploy.processes.launcher import RunOutcome
from deploy.processes.network.links import check_link, require_keys, require_own_controller
from deploy.processes.network.real_delay import LONGEST_MS, RELAY
from deploy.processes.network.relay_process import run_relay
from deploy.processes.parent import end_with_parent
from deploy.processes.processes import (
    StopRequest,
    run_controller,
    run_plant,
    run_recorder,
)
from deploy.processes.status import StatusReporter
from deploy.runs.run_folder import RunFolder
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError

ParentPid = Annotated[int | None, typer.Option("--to-parent", hidden=True)]
"""Process id of `run`: report to it, and end with it."""
AwaitRecorder = Annotated[
    bool, typer.Option("--await-recorder", help="Start only once a recorder listens.")
]


def controller(
    scenario: ScenarioArgument,
    overrides: Overrides = None,
    await_recorder: AwaitRecorder = False,
    parent_pid: ParentPid = None,
) -> None:
    """Be the controller: answer the joint states of a plant on the bus."""
    reporter = reporter_of(Role.CONTROLLER, parent_pid)
    setup = load_setup(scenario, overrides or [])
    check_link(setup, one_process=False)
    require_own_controller(setup)
    require_keys(setup, Role.CONTROLLER)
    raise typer.Exit(run_controller(setup, reporter, await_recorder=await_recorder))


def plant(
    scenario: ScenarioArgument,
    overrides: Overrides = None,
    await_recorder: AwaitRecorder = False,
    can_log: Annotated[
        Path | None, typer.Option("--can-log", help="File for the frames of a CAN bus.")
    ] = None,
    parent_pid: ParentPid = None,
) -> None:
    """Be the plant: emulate the arm for a controller on the bus."""
    reporter = reporter_of(Role.PLANT, parent_pid)
    setup = load_setup(scenario, overrides or [])
    check_link(setup, one_process=False)
    require_keys(setup, Role.PLANT)
    raise typer.Exit(run_plant(setup, reporter, await_recorder=await_recorder, can_log=can_log))


def record(
    scenario: ScenarioArgument,
    overrides: Overrides = None,
    out: Out = None,
    overwrite: Overwrite = False,
    log: Annotated[Path | None, typer.Option("--log", hidden=True)] = None,
    parent_pid: ParentPid = None,
) -> None:
    """Be the recorder: write every message on the bus to a run folder."""
    reporter = reporter_of(Role.RECORDER, parent_pid)
    setup = load_setup(scenario, overrides or [])
    require_keys(setup, Role.RECORDER)
    stop = StopRequest()
    if log is not None:
        raise typer.Exit(run_recorder(setup, log, reporter, stop))
    folder = RunFolder.begin(setup, out, overwrite=overwrite)
    with folder:
        code = run_recorder(setup, folder.log, reporter, stop)
        if code == FINISHED or partial_path(folder.log).exists():
            outcome = RunOutcome(interrupted=stop.is_set)
            finish(Console(), folder, outcome, require_bounds=False)
        raise typer.Exit(code)


def relay(
    listen: Annotated[str, typer.Argument(help="HOST:PORT where connections come in.")],
    connect: Annotated[str, typer.Argument(help="HOST:PORT that they are passed on to.")],
    delay_ms: Annotated[
        float, typer.Option("--delay", metavar="MS", help="Hold bytes back for so long, each way.")
    ],
    parent_pid: ParentPid = None,
) -> None:
    """Be a relay between two TCP peers: hold back every byte between controller and plant."""
    reporter = reporter_of(RELAY, parent_pid)
    if not 0.0 <= delay_ms <= LONGEST_MS:
        raise ScenarioError(f"--delay {delay_ms:g}: must be 0 to {LONGEST_MS:g} ms")
    raise typer.Exit(run_relay(_address(listen), _address(connect), delay_ms, reporter))


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not (host and port.isdecimal() and 0 < int(port) < 1 << 16):
        raise ScenarioError(f"{text!r}: must be HOST:PORT such as 127.0.0.1:7453")
    return host.strip("[]"), int(port)


def reporter_of(role: str, parent_pid: int | None) -> StatusReporter:
    """The reporter of a process; one that has a parent ends with it, and is its only reporter.

    What anything else prints, such as a law, goes to standard error.
    """
    if parent_pid is None:
        return StatusReporter(role, to_parent=None)
    end_with_parent(parent_pid)
    channel = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    return StatusReporter(role, to_parent=channel)

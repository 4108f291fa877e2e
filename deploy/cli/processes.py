"""Commands that start one process of a run: `controller`, `plant`, `record` and `relay`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from bus_schema.messages.topics import Role
from bus_schema.recording.atomic_files import partial_path
from deploy.cli.parts.common import finish
from deploy.cli.parts.options import OneRunOptions, Out, Overrides, Overwrite, ScenarioArgument
from deploy.run.console import Console
from deploy.run.execute import recorded
from deploy.run.exit_codes import FINISHED
from deploy.run.network.links import require_keys
from deploy.run.network.real_delay import LONGEST_MS, RELAY, RelayOptions, host_and_port
from deploy.run.processes import relay as relaying
from deploy.run.processes import roles
from deploy.run.processes.child import RunOutcome
from deploy.run.processes.roles import RoleOptions
from deploy.run.processes.status import StatusReporter
from deploy.run.run_folder import RunFolder
from deploy.run.stop_signals import StopRequest
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError

AwaitRecorder = Annotated[
    bool, typer.Option("--await-recorder", help="Start only after a recorder has connected.")
]


def controller(
    scenario: ScenarioArgument, overrides: Overrides = None, await_recorder: AwaitRecorder = False
) -> None:
    """Run the controller alone: it answers the joint states of a plant on the bus."""
    options = RoleOptions(scenario, overrides or [], await_recorder)
    raise typer.Exit(roles.controller(options, StatusReporter(Role.CONTROLLER)))


def plant(
    scenario: ScenarioArgument,
    overrides: Overrides = None,
    await_recorder: AwaitRecorder = False,
    can_log: Annotated[Path | None, typer.Option(help="File for the frames of a CAN bus.")] = None,
) -> None:
    """Run the plant alone: it emulates the arm for a controller on the bus."""
    options = RoleOptions(scenario, overrides or [], await_recorder, can_log)
    raise typer.Exit(roles.plant(options, StatusReporter(Role.PLANT)))


def record(
    scenario: ScenarioArgument,
    overrides: Overrides = None,
    out: Out = None,
    overwrite: Overwrite = False,
) -> None:
    """Run the recorder alone: it writes every message on the bus to a run folder."""
    setup = load_setup(scenario, overrides or [])
    require_keys(setup, Role.RECORDER)
    stop = StopRequest()
    with RunFolder.begin(setup, out, overwrite=overwrite) as folder:
        code = roles.run_recorder(setup, folder.log, StatusReporter(Role.RECORDER), stop)
        if code == FINISHED or partial_path(folder.log).exists():
            outcome = RunOutcome(interrupted=stop.is_set)
            finish(Console(), folder, recorded(folder, outcome), OneRunOptions())
        raise typer.Exit(code)


def relay(
    listen: Annotated[str, typer.Argument(help="HOST:PORT to listen at.")],
    connect: Annotated[str, typer.Argument(help="HOST:PORT to pass messages on to.")],
    delay_ms: Annotated[
        float | None, typer.Option("--delay", metavar="MS", help="Delay in each direction.")
    ] = None,
    scenario: Annotated[
        str, typer.Option(help="Scenario whose link.uplink, link.downlink and seed apply.")
    ] = "paper_arm",
    overrides: Overrides = None,
    is_udp: Annotated[bool, typer.Option("--udp", help="Relay UDP instead of TCP.")] = False,
    duration_s: Annotated[
        float, typer.Option("--duration", metavar="S", help="Stop after this time.")
    ] = math.inf,
) -> None:
    """Relay messages between two programs, and impair them as an emulated link does.

    Messages to CONNECT pass link.downlink, and answers pass link.uplink: delay, jitter, loss,
    traces and the other keys. Over TCP, lost data are sent again, and later data wait for them.
    """
    delays = []
    if delay_ms is not None:
        if not 0.0 <= delay_ms <= LONGEST_MS:
            raise ScenarioError(f"--delay {delay_ms:g}: must be 0 to {LONGEST_MS:g} ms")
        delays = [f"link.{way}.delay_ms={delay_ms}" for way in ("uplink", "downlink")]
    for each in (listen, connect):
        host_and_port(each)
    given = load_setup(scenario, [*delays, *(overrides or [])]).scenario
    options = RelayOptions(listen, connect, given.link, given.seed, is_udp, duration_s)
    raise typer.Exit(relaying.relay(options, StatusReporter(RELAY)))

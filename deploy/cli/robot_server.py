"""The command `robot-server`: an emulated robot that answers its vendor's own client."""

from __future__ import annotations

import queue
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Annotated

import typer

from bus_schema.configuration import ConfigurationError
from bus_schema.errors import did_you_mean
from deploy.cli.parts.common import say_warnings, show_results
from deploy.cli.parts.options import (
    NetworkOption,
    NoReport,
    Out,
    Overrides,
    Overwrite,
    ScenarioArgument,
    finite,
)
from deploy.reports.results import write_run
from deploy.run.console import Console
from deploy.run.exit_codes import FINISHED, INTERRUPTED
from deploy.run.network.links import with_free_endpoints
from deploy.run.network.live_feed import clear_left_behind
from deploy.run.new_folder import resolved_out
from deploy.run.processes.child import LiveViewer
from deploy.run.processes.status import StatusMessage
from deploy.run.run_folder import RunFolder
from deploy.run.serve_robot import Place, ServedRobot
from deploy.run.stop_signals import on_stop
from deploy.scenario.definition import LONGEST_S
from deploy.scenario.interface_choice import interface_values, takes_of
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.study_keys import TRACES
from deploy.scenario.yaml_files import ScenarioError, override
from plant_emulator.interfaces.configuration import INTERFACES
from plant_emulator.robot_servers.robot_server import ROBOT_SERVERS, RobotServer

_LOCAL = "127.0.0.1"
_PORTS = 1 << 16

Interface = Annotated[
    str,
    typer.Option(
        metavar="KIND",
        help="Interface of the robot: servoj or speedj (ur-rtde), egm (ABB), franka_position,"
        " franka_velocity or franka_torque (libfranka).",
    ),
]
Vendor = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="Vendor of the robot, if its interface does not tell: xarm, with servoj.",
        show_default=False,
    ),
]
Host = Annotated[str, typer.Option(help="Address to listen at.")]
Client = Annotated[
    str | None,
    typer.Option(
        metavar="HOST[:PORT]",
        help=f"With egm, where the robot sends first: {_LOCAL} and the usual port by default.",
        show_default=False,
    ),
]
Live = Annotated[
    bool, typer.Option("--live", help="Show the run live in the browser and in Foxglove.")
]
Duration = Annotated[
    float | None,
    typer.Option(
        "--duration",
        metavar="S",
        min=0.001,
        max=LONGEST_S,
        callback=finite,
        help="Stop after this time.",
    ),
]


def robot_server(
    scenario: ScenarioArgument = "ur5e_motors",
    interface: Interface = "servoj",
    vendor: Vendor = None,
    network: NetworkOption = None,
    overrides: Overrides = None,
    host: Host = _LOCAL,
    client: Client = None,
    live: Live = False,
    no_report: NoReport = False,
    duration_s: Duration = None,
    out: Out = None,
    overwrite: Overwrite = False,
) -> None:
    """Emulate a robot that answers its vendor's own client, such as ur-rtde, over a network.

    Results are those of other runs: the reference is what the client asks for.
    """
    setup, server_type = _checked(scenario, interface, vendor, network, overrides)
    place = _place(server_type, interface, host, client)
    say_warnings(setup)
    setup = with_free_endpoints(setup)
    console = Console(highlight=False, markup=False, soft_wrap=True)
    ticks = None if duration_s is None else round(duration_s * 1e9 / setup.grid.period_ns)
    folder = resolved_out(out or Path("runs", f"robot-{setup.scenario.name}"))
    robot = ServedRobot(setup, server_type, interface, place, console.print)
    on_stop(robot.request_stop)
    # A taken port leaves no folder behind.
    with robot.opened(), RunFolder.begin(setup, folder, overwrite=overwrite) as kept:
        with _live_view(kept, console) if live else nullcontext():
            run = robot.run(kept, ticks)
        show_results(console, kept, lambda: write_run(kept, run, draws_report=not no_report))
    raise typer.Exit(INTERRUPTED if run.outcome.interrupted else FINISHED)


@contextmanager
def _live_view(folder: RunFolder, console: Console) -> Iterator[None]:
    """Show the run in a process of its own."""
    from deploy.cli.view import view_beside  # which alone loads the viewer

    inbox: queue.SimpleQueue[StatusMessage] = queue.SimpleQueue()
    viewer = LiveViewer(view_beside, folder.path, inbox)
    try:
        while not inbox.empty():
            console.print(str(inbox.get().values.get("text", "")))
        yield
    finally:
        viewer.end()
        clear_left_behind()


def _place(server_type: type[RobotServer], interface: str, host: str, client: str | None) -> Place:
    """Return the addresses that the options name; raises ScenarioError."""
    if client is None:
        return Place(host, _LOCAL, server_type.ports)
    if not server_type.calls_client:
        raise ScenarioError(f"--client {client}: must be left out with --interface {interface}")
    name, _, port = client.partition(":")
    if not name or (":" in client and not (port.isdecimal() and 0 < int(port) < _PORTS)):
        raise ScenarioError(f"--client {client}: must be HOST or HOST:PORT, such as {_LOCAL}:6510")
    ports = {each: int(port or usual) for each, usual in server_type.ports.items()}
    return Place(host, name, ports)


def _server(interface: str, vendor: str | None) -> type[RobotServer]:
    """Return the server that the options name; raises ScenarioError."""
    takes_of(interface)
    named = [name for name in ROBOT_SERVERS if name not in INTERFACES]
    try:
        if vendor is None:
            if interface not in ROBOT_SERVERS:
                kinds = [name for name in ROBOT_SERVERS if name in INTERFACES]
                hint = did_you_mean(interface, kinds)
                allowed = f"must be one of {', '.join(kinds)}{hint}"
                raise ScenarioError(f"--interface {interface}: {allowed}")
            return ROBOT_SERVERS[interface]
        if vendor not in named:
            allowed = f"must be left out, or {' or '.join(named)}{did_you_mean(vendor, named)}"
            raise ScenarioError(f"--vendor {vendor}: {allowed}")
        server = ROBOT_SERVERS[vendor]
    except ConfigurationError as error:
        raise ScenarioError(f"--interface {interface}: {error.allowed}") from error
    if interface not in server.interfaces:
        allowed = " or ".join(server.interfaces)
        raise ScenarioError(f"--interface {interface}: must be {allowed} with --vendor {vendor}")
    return server


def _checked(
    arm: str, interface: str, vendor: str | None, network: str | None, overrides: list[str] | None
) -> tuple[Setup, type[RobotServer]]:
    """Return the scenario and the server of its robot; raises ScenarioError."""
    server = _server(interface, vendor)
    traces = {} if network is None else dict.fromkeys(TRACES, network)
    given = {**interface_values(server.arm_kind or interface), **traces}
    words = [override(key, value) for key, value in given.items()]
    setup = load_setup(arm, [*words, *(overrides or [])])
    known = server.joints if isinstance(server.joints, range | None) else (server.joints,)
    if known is not None and setup.robot.joints not in known:
        raise ScenarioError(
            f"{arm}: has {setup.robot.joints} driven joints: must have"
            f" {' or '.join(map(str, known))} for --interface {vendor or interface}"
        )
    return setup, server

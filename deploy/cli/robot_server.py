"""The command `robot-server`: an emulated robot that answers its vendor's own client."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from bus_schema.arrays import Vector
from bus_schema.configuration import ConfigurationError
from bus_schema.recording.atomic_files import write_json
from bus_schema.runtime.clock import MonotonicClock
from deploy.command.common import say_warnings
from deploy.command.options import Out, Overrides, Overwrite, ScenarioArgument
from deploy.judge.joint_lag import LagMeter
from deploy.run.console import Console
from deploy.run.exit_codes import FINISHED, INTERRUPTED
from deploy.run.network.link_relay import LinkRelay
from deploy.run.new_folder import new_folder, resolved_out
from deploy.run.run_folder import provenance
from deploy.run.stop_signals import on_stop
from deploy.scenario.interface_choice import interface_values, takes_of
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import ScenarioError, override
from plant_emulator.robot_servers.robot_rig import RobotRig
from plant_emulator.robot_servers.robot_server import ROBOT_SERVERS, RobotServer

_TRACES = ("link.uplink.trace.file", "link.downlink.trace.file")
_LOCAL = "127.0.0.1"

Interface = Annotated[
    str, typer.Option(metavar="KIND", help="Interface of the robot: servoj or speedj.")
]
Network = Annotated[
    str | None, typer.Option(metavar="LOG", help="A file of delays, or a shipped trace.")
]
Host = Annotated[str, typer.Option(help="Address to listen at.")]
Duration = Annotated[
    float | None,
    typer.Option("--duration", metavar="S", min=0.001, help="Stop after this time."),
]


def robot_server(
    scenario: ScenarioArgument = "ur5e_motors",
    interface: Interface = "servoj",
    network: Network = None,
    overrides: Overrides = None,
    host: Host = _LOCAL,
    duration_s: Duration = None,
    out: Out = None,
    overwrite: Overwrite = False,
) -> None:
    """Emulate a robot that answers its vendor's own client, such as ur-rtde, over a network.

    Results are the motion, and why the robot stopped.
    """
    setup, server_type = _checked(scenario, interface, network, overrides)
    say_warnings(setup)
    folder = resolved_out(out or Path("runs", f"robot-{setup.scenario.name}"))
    new_folder("robot-server", folder, overwrite=overwrite)
    raise typer.Exit(_serve(setup, server_type, host, duration_s, folder))


def _checked(
    arm: str, interface: str, network: str | None, overrides: list[str] | None
) -> tuple[Setup, type[RobotServer]]:
    """Return the scenario and the server of its robot; raises ScenarioError."""
    takes_of(interface)
    try:
        server = ROBOT_SERVERS[interface]
    except ConfigurationError as error:
        raise ScenarioError(f"--interface {interface}: {error.allowed}") from error
    traces = {} if network is None else dict.fromkeys(_TRACES, network)
    given = {**interface_values(interface), **traces}
    words = [override(key, value) for key, value in given.items()]
    setup = load_setup(arm, [*words, *(overrides or [])])
    if server.joints not in (None, setup.robot.joints):
        raise ScenarioError(
            f"{arm}: has {setup.robot.joints} driven joints: must have {server.joints} for"
            f" --interface {interface}"
        )
    return setup, server


def _serve(
    setup: Setup, server_type: type[RobotServer], host: str, duration_s: float | None, out: Path
) -> int:
    """Run the robot until it stops, and write its results; returns the exit code."""
    console, clock = Console(highlight=False, markup=False, soft_wrap=True), MonotonicClock()
    interface = setup.scenario.plant.interface

    def say(sentence: str) -> None:
        console.print(f"{clock.now_ns() * 1e-9:9.4f}  {sentence}")

    server = server_type(interface.settings, interface.period_s, say)
    arm, lag = setup.arm(), LagMeter(setup.robot.joints)
    arm.be_controlled_by(setup.robot_controller(server.interface))
    ticks = None if duration_s is None else round(duration_s * 1e9 / setup.grid.period_ns)
    with motion_file(out / "motion.csv", setup.robot.joint_names) as write:

        def record(now_s: float, actual_rad: Vector, target_rad: Vector) -> None:
            write(now_s, actual_rad, target_rad)
            lag.add(now_s, actual_rad, target_rad)

        rig = RobotRig(arm, server, clock, setup.grid, record)
        on_stop(rig.request_stop)
        clock.start()
        with listening(server, setup, host) as relay:
            ports = ", ".join(f"{name} {port}" for name, port in server.ports.items())
            console.print(f"{setup.scenario.name} listens at {host}: {ports}")
            try:
                rig.run(ticks)
            finally:
                arm.close()
                server.close()
            counts = None if relay is None else relay.counts()
    is_whole = ticks is None or rig.ticks >= ticks
    summary = {
        "kind": "robot_server",
        "name": setup.scenario.name,
        "interface": interface.kind,
        "completed": is_whole,
        "duration_s": rig.ticks * setup.grid.period_ns * 1e-9,
        "ticks": rig.ticks,
        "skipped": rig.skipped,
        **server.counts,
        "lag_ms": lag.finish(),
        "network": counts,
    }
    write_json(out / "manifest.json", provenance())
    write_json(out / "summary.json", summary)
    known = [lag for lag in summary["lag_ms"] if lag is not None]
    if known:
        console.print(f"joints were up to {max(known, key=abs):.3g} ms behind their targets")
    for stop in summary["stops"]:
        console.print(f"stopped at {stop['time_s']:.3f} s: {stop['reason']}")
    console.print(f"results: {out}")
    return FINISHED if is_whole else INTERRUPTED


@contextmanager
def motion_file(
    file: Path, names: Sequence[str]
) -> Iterator[Callable[[float, Vector, Vector], None]]:
    """Open a CSV file; what it gives writes a row: time, measured positions, those asked for."""
    heads = ["time_s", *(f"{n}.position_rad" for n in names), *(f"{n}.target_rad" for n in names)]
    with file.open("w", encoding="utf-8", newline="\n") as rows:

        def write(time_s: float, actual_rad: Vector, target_rad: Vector) -> None:
            row = (time_s, *actual_rad.tolist(), *target_rad.tolist())
            rows.write(",".join(f"{value:.9g}" for value in row) + "\n")

        rows.write(",".join(heads) + "\n")
        yield write


@contextmanager
def listening(server: RobotServer, setup: Setup, host: str) -> Iterator[LinkRelay | None]:
    """Open the server's ports; with a network, a relay delays the traffic of one of them."""
    try:
        relay = _opened(server, setup, host)
    except OSError as error:
        raise ScenarioError(f"--host {host}: {error.strerror or error}") from error
    if relay is None:
        yield None
        return
    stop = threading.Event()
    thread = threading.Thread(target=relay.run, args=(stop.is_set,), daemon=True)
    thread.start()
    try:
        yield relay
    finally:
        stop.set()
        thread.join()


def _opened(server: RobotServer, setup: Setup, host: str) -> LinkRelay | None:
    """Open the server's ports; return the relay if the link is a network."""
    link, ports = setup.link, dict(server.ports)
    if not any(not way.is_constant or way.delay_ms for way in (link.uplink, link.downlink)):
        server.open(host, ports)
        return None
    with socket.create_server((_LOCAL, 0)) as free:
        inner = free.getsockname()[1]
    server.open(_LOCAL, {server.relayed: inner})
    server.open(host, {name: port for name, port in ports.items() if name != server.relayed})
    outer = socket.create_server((host, ports[server.relayed]))
    return LinkRelay(outer, (_LOCAL, inner), link, setup.scenario.seed)

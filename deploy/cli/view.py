"""The command `view`: shows a run in the browser and in Foxglove, live or from a recording."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from bus_schema.link.configuration import LinkConfiguration
from bus_schema.recording.atomic_files import write_json
from controller.laws.custom import custom_laws_left_out
from deploy.reports.live.foxglove_layout import foxglove_layout
from deploy.reports.live.playback import Playback
from deploy.reports.live.viewer import Source, Viewer, stand_back
from deploy.run.exit_codes import FAULT, FINISHED, INTERRUPTED
from deploy.run.network.live_feed import FeedReceiver
from deploy.run.processes.scheduling import leave_loops_their_cpus
from deploy.run.processes.status import StatusReporter
from deploy.run.run_folder import RunFolder, load_run
from deploy.run.stop_signals import StopRequest
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup

_ENDPOINT = re.compile(r"[a-z-]+/[^/]*:\d+")
_AWAIT_RECORDER_S = 3.0
_POLL_S = 0.1
_SLOWEST, _FASTEST = 0.01, 100.0

Target = Annotated[
    str | None,
    typer.Argument(
        metavar="[ENDPOINT|RUN]",
        help="The plant's endpoint in a run under way that is recorded on this machine"
        f" ({LinkConfiguration().plant_endpoint} by default); or the folder of a run, or its"
        " MCAP file.",
        show_default=False,
    ),
]
OpenViewer = Callable[[Setup, str], Viewer]


def view(
    target: Target = None,
    speed: Annotated[
        float,
        typer.Option(min=_SLOWEST, max=_FASTEST, help="Playback speed of a RUN."),
    ] = 1.0,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port of the page; 0 for any.")] = 0,
    foxglove_port: Annotated[
        int | None,
        typer.Option(
            min=0, max=65535, show_default=False,
            help="Port of Foxglove's server; 8765 by default, or any free port.",
        ),
    ] = None,
    layout: Annotated[
        Path | None, typer.Option(help="Write a layout for Foxglove to this file.")
    ] = None,
) -> None:  # fmt: skip
    """Show a run in the browser and in Foxglove, live or from a recording."""
    stop = StopRequest()
    stand_back()
    leave_loops_their_cpus()

    def open_viewer(setup: Setup, source_name: str) -> Viewer:
        if layout is not None:
            write_json(layout, foxglove_layout(setup))
        viewer = Viewer(setup, source_name, port=port, foxglove_port=foxglove_port)
        print(viewer.places(), flush=True)
        return viewer

    _show(target, speed, open_viewer, stop)
    raise typer.Exit(INTERRUPTED if stop.is_set else FINISHED)


def view_beside(folder: Path, reporter: StatusReporter) -> int:
    """Show the run that will begin in a folder, until asked to stop. Returns the exit code."""
    stop = StopRequest()
    stand_back()
    leave_loops_their_cpus()
    with custom_laws_left_out():
        setup = load_setup(str(RunFolder(folder).scenario))
        endpoint = setup.scenario.link.plant_endpoint
        viewer = Viewer(setup, f"at {endpoint}", port=0, foxglove_port=None)
        reporter.report("note", text=viewer.places())
        _serve(viewer, FeedReceiver(endpoint), lambda: stop.is_set)
    return FINISHED


def _show(target: str | None, speed: float, open_viewer: OpenViewer, stop: StopRequest) -> None:
    """Show the run that the user names: a live one, or a recording."""
    folder = RunFolder(Path(target or ""))
    if target is None or (_ENDPOINT.fullmatch(target) and not folder.path.exists()):
        endpoint = target or LinkConfiguration().plant_endpoint
        if not _watch(endpoint, open_viewer, stop) and not stop.is_set:
            typer.echo(f"error: no recorder on this machine records a run at {endpoint}", err=True)
            raise typer.Exit(FAULT)
    elif folder.log.exists() or not folder.scenario.exists():
        _play(folder.path, speed, open_viewer, stop)
    else:
        endpoint = load_setup(str(folder.scenario)).scenario.link.plant_endpoint
        if not _watch(endpoint, open_viewer, stop):
            _play(folder.path, speed, open_viewer, stop)


def _watch(endpoint: str, open_viewer: OpenViewer, stop: StopRequest) -> bool:
    """Show the run in progress at an endpoint until it ends. Returns whether there was one."""
    receiver = FeedReceiver(endpoint)
    try:
        give_up_s = time.monotonic() + _AWAIT_RECORDER_S
        while receiver.scenario is None:
            if stop.is_set or time.monotonic() > give_up_s:
                return False
            receiver.receive(_POLL_S)
        viewer = open_viewer(load_setup(str(receiver.scenario)), f"at {endpoint}")
        _serve(viewer, receiver, lambda: stop.is_set or receiver.is_over)
    finally:
        receiver.close()
    if not stop.is_set:
        print("the run is over")
    return True


def _play(path: Path, speed: float, open_viewer: OpenViewer, stop: StopRequest) -> None:
    """Play a recording when the first viewer connects, then keep its end on show."""
    data, contents = load_run(path)
    viewer = open_viewer(data.setup, f"recorded, {path}")
    names = data.setup.robot.joint_names
    playback = Playback(contents.payloads, names, speed, lambda: viewer.is_watched)
    _serve(viewer, playback, lambda: stop.is_set or playback.is_over, lambda: stop.is_set)


def _serve(
    viewer: Viewer,
    source: Source,
    is_over: Callable[[], bool],
    may_close: Callable[[], bool] = lambda: True,
) -> None:
    """Show a source until it ends, then its last state until the viewer may close."""
    try:
        viewer.run(source, is_over)
        while not may_close():
            time.sleep(_POLL_S)
    finally:
        source.close()
        viewer.close()

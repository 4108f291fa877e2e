"""The command `datasheet`: one command to the answer how much delay an arm takes."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from bus_schema.recording.atomic_files import write_json
from deploy.cli.parts.common import ResultGate, leave, parse_laws, say_warnings, show_results
from deploy.cli.parts.options import (
    GateOptions,
    InterfaceOption,
    NetworkOption,
    ScenarioArgument,
    taking,
)
from deploy.cli.parts.progress import CommandProgress
from deploy.cli.parts.study_command import RunCounter, SharedWorkers, carried_out
from deploy.cli.parts.study_options import WorkerOptions
from deploy.judge.gate import Gauged
from deploy.judge.run_rows import Row
from deploy.reports.results import Results
from deploy.reports.studies.results import write_study
from deploy.run.console import Console
from deploy.run.exit_codes import FAULT, INTERRUPTED
from deploy.run.run_folder import ResultFolder, provenance
from deploy.run.stop_signals import on_stop
from deploy.scenario.interface_choice import has_controller, interface_values
from deploy.scenario.yaml_files import ScenarioError
from deploy.studies.datasheet.data_sheet import DataSheet
from deploy.studies.datasheet.results import (
    OF_ROBOT,
    sheet_folder,
    sheet_parts,
    write_data_sheet,
    write_robot_sheet,
)
from deploy.studies.datasheet.robot_sheet import RobotSheet, run_row
from deploy.study.study import StudyOfRuns

_LAW = "fixed_time_adaptive"
_MOST_WINDOWS = 1000
_FURTHEST = "the largest value that a data sheet tries (funnel-hil margin --limit tries more)"


@dataclass(kw_only=True)
class DatasheetOptions(GateOptions, WorkerOptions):
    """The options of `datasheet`."""

    scenario: ScenarioArgument = "paper_arm"
    law: Annotated[
        str | None,
        typer.Option(help=f"The control law; by default {_LAW}, or those of the interface."),
    ] = None
    interface: InterfaceOption = None
    network: NetworkOption = None
    windows: Annotated[
        int | None,
        typer.Option(
            min=2,
            max=_MOST_WINDOWS,
            metavar="N",
            help="Windows of the network; default 12, or 5 with --quick.",
        ),
    ] = None
    plants: Annotated[int, typer.Option(min=0, help="Number of uncertain plants.")] = 0
    quick: Annotated[bool, typer.Option("--quick", help="Fewer and shorter runs.")] = False


@taking(DatasheetOptions)
def datasheet(options: DatasheetOptions) -> None:
    """Answer on one page how much delay an arm takes.

    The page has the margins for constant and for varying delays, the share of windows of a network
    and of uncertain plants that keep their bounds, the worst window, and what helps. For a robot
    with a controller of its own (--interface), it says how far the tip is behind, and which reflex
    stops the robot. After an interruption or a kill, the same command continues.
    """
    parse_laws(options.law, "--law")
    if options.windows is not None and options.network is None:
        raise ScenarioError(f"--windows {options.windows}: needs --network")
    if has_controller(options.interface):
        _of_robot(options, options.interface)
        return
    sheet = torque_sheet(options)
    margin, windows = sheet.margin(), sheet.windows()
    tested = sheet.tested_with(margin.tested_with) or {}
    gate = ResultGate(options, "datasheet", "ms", tested, "datasheet", furthest=_furthest(margin))
    console, stop = Console(), threading.Event()
    out = sheet_folder(sheet, options.out, overwrite=options.overwrite)
    say_warnings(*margin.bases, *(() if windows is None else windows.bases))
    of_network = 0 if windows is None else windows.at_most
    later = {margin.kind: of_network + sheet.plants_at_most}
    later |= {} if windows is None else {windows.kind: sheet.plants_at_most}
    with (
        SharedWorkers() as workers,
        CommandProgress(console, "data sheet", margin.at_most + later[margin.kind], "runs") as line,
    ):
        counter = RunCounter(line)

        def make(study: StudyOfRuns, folder: Path) -> tuple[dict[str, Any], list[Row]]:
            counter.begin(later.get(study.kind, 0))
            return _made(study, options, folder, console, stop, workers, counter)

        parts, window = sheet_parts(sheet, margin, windows, out, make)
    _leave_if_stopped(stop, console)
    _written(out, gate, console, lambda folder: write_data_sheet(folder, sheet, parts, window))


def torque_sheet(options: DatasheetOptions) -> DataSheet:
    """Return the data sheet of an arm that takes torques."""
    fixed = {**interface_values(options.interface), **options.fixed()}
    return DataSheet(
        options.scenario, options.law or _LAW, options.network, options.plants, fixed,
        options.quick, options.windows,
    )  # fmt: skip


def _of_robot(options: DatasheetOptions, interface: str) -> None:
    """Answer for a robot that has a controller of its own."""
    if options.plants:
        raise ScenarioError(f"--plants: must be left out with --interface {interface}")
    sheet = RobotSheet(
        options.scenario, interface, options.law, options.network, options.fixed(), options.quick,
        options.windows,
    )  # fmt: skip
    margin, planned = sheet.margin(), list(sheet.runs())
    gate = ResultGate(
        options, "datasheet", "ms", margin.tested_with, OF_ROBOT, furthest=_furthest(margin)
    )
    console, stop = Console(), threading.Event()
    out = sheet_folder(sheet, options.out, overwrite=options.overwrite)
    say_warnings(planned[0][2])
    found, _ = _made(margin, options, out / "margin", console, stop)
    rows = []
    on_stop(stop.set)
    with CommandProgress(console, "robot", len(planned), "runs") as progress:
        for done, run in enumerate(planned):
            _leave_if_stopped(stop, console)
            progress.update(done)
            rows.append(run_row(*run))
    _written(out, gate, console, lambda folder: write_robot_sheet(folder, sheet, found, rows))


def _furthest(margin: StudyOfRuns) -> Gauged | None:
    """Return the last value that its search for margins tries, which no option of it sets."""
    found = margin.furthest
    return None if found is None else replace(found, name=_FURTHEST)


def _written(
    out: Path, gate: ResultGate, console: Console, write: Callable[[ResultFolder], Results]
) -> None:
    """Write a data sheet, show it, and end with its exit code."""
    with ResultFolder(out).lock() as folder:
        write_json(folder.manifest, provenance())
        results = show_results(console, folder, lambda: write(folder))
    leave(interrupted=False, whole=True, kept=gate.is_passed(results.summary, console))


def _made(
    study: StudyOfRuns, options: DatasheetOptions, out: Path, console: Console,
    stop: threading.Event, workers: SharedWorkers | None = None,
    counter: RunCounter | None = None,
) -> tuple[dict[str, Any], list[Row]]:  # fmt: skip
    """Do a part of the data sheet; return its summary, and its rows."""
    own = replace(options, out=out, overwrite=False)
    with carried_out(study, own, console, stop, workers, counter) as done:
        summary, rows = write_study(study, done.folder).summary, done.folder.rows
    _leave_if_stopped(stop, console)
    if summary["runs_failed"] == summary["runs"]:
        console.print(f"every run failed: {summary['commonest_error']}", markup=False)
        raise typer.Exit(FAULT)
    if not summary["completed"]:
        console.print(f"{done.lost or 'not complete'}: repeat the same command to continue.")
        raise typer.Exit(FAULT)
    return summary, rows


def _leave_if_stopped(stop: threading.Event, console: Console) -> None:
    if stop.is_set():
        console.print("stopped: repeat the same command to continue.", markup=False)
        raise typer.Exit(INTERRUPTED)

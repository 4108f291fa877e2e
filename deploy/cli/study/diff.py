"""The command `diff`: recorded runs side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from bus_schema.recording.atomic_files import write_json
from deploy.cli.common import show_places
from deploy.cli.options import NoReport, Out, Overwrite
from deploy.comparison.recorded import KIND, RecordedRuns, recorded_runs
from deploy.reports.studies.diff_report import conclude_diff
from deploy.reports.studies.diff_tables import (
    joint_tables,
    run_tables,
    timing_table,
    verdict_on_runs,
)
from deploy.reports.terminal import print_table
from deploy.runs.new_folder import new_folder
from deploy.runs.run_folder import ResultFolder, provenance


def diff(
    runs: Annotated[
        list[Path], typer.Argument(metavar="RUN RUN…", help="Folders or MCAP files of runs.")
    ],
    out: Out = None,
    overwrite: Overwrite = False,
    no_report: NoReport = False,
) -> None:
    """Set recorded runs side by side: real time and lockstep, two laws, two versions.

    The first is what the others are held against. They may differ in everything but their joints.
    """
    compared = recorded_runs(runs)
    folder = ResultFolder(new_folder(KIND, out, overwrite=overwrite))
    folder.lock()
    with folder:
        write_json(folder.manifest, provenance())
        show_diff(compared, folder, Console(), draws_report=not no_report)


def show_diff(
    compared: RecordedRuns, folder: ResultFolder, console: Console, *, draws_report: bool = True
) -> None:
    """Write summary and report, and show what came of it."""
    conclude_diff(compared, folder, draws_report=draws_report)
    for table in (*joint_tables(compared), timing_table(compared), *run_tables(compared)):
        print_table(console, table)
    verdict = verdict_on_runs(compared)
    console.print(verdict.headline, style="bold", markup=False)
    for reason in verdict.reasons:
        console.print(reason, markup=False, highlight=False)
    show_places(console, folder)

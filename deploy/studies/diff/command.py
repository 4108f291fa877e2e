"""The command `diff`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bus_schema.recording.atomic_files import write_json
from deploy.cli.parts.common import show_results
from deploy.cli.parts.options import NoReport, Out, Overwrite
from deploy.reports.results import write_results
from deploy.run.console import Console
from deploy.run.new_folder import new_folder
from deploy.run.run_folder import ResultFolder, provenance
from deploy.studies.diff.results import diff_results
from deploy.study.comparison.recorded import KIND as DIFF
from deploy.study.comparison.recorded import recorded_runs


def diff(
    runs: Annotated[
        list[Path], typer.Argument(metavar="RUN RUN…", help="Folders or MCAP files of runs.")
    ],
    out: Out = None,
    overwrite: Overwrite = False,
    no_report: NoReport = False,
) -> None:
    """Compare recorded runs: real time and lockstep, two laws, two versions.

    All runs are compared with the first. They may differ in everything but their joints.
    """
    compared = recorded_runs(runs)
    with ResultFolder(new_folder(DIFF, out, overwrite=overwrite)).lock() as folder:
        write_json(folder.manifest, provenance())
        results = diff_results(compared)
        show_results(
            Console(), folder, lambda: write_results(folder, results, draws_report=not no_report)
        )

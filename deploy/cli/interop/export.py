"""The command `export`: a run as tables, for other programs."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from deploy.exit_codes import FAULT, FINISHED
from deploy.reports.verdict import PARTIAL, damaged, missing_ticks_sentence
from deploy.runs.export import Format, export_series
from deploy.runs.judging.known_ticks import known_ticks
from deploy.runs.judging.time_series import SERIES
from deploy.runs.run_data import RunData
from deploy.runs.run_folder import load_run
from deploy.scenario.yaml_files import ScenarioError


def export(
    run_dir: Annotated[Path, typer.Argument(metavar="RUN", help="Folder or MCAP file of a run.")],
    csv: Annotated[bool, typer.Option("--csv", help="Write CSV files.")] = False,
    parquet: Annotated[bool, typer.Option("--parquet", help="Write Parquet files.")] = False,
    names: Annotated[
        list[str] | None,
        typer.Option("--series", metavar="NAME", help="Only this series; repeatable."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for the files; RUN/export by default.")
    ] = None,
) -> None:
    """Write a recorded run as tables over time: what is judged, and every topic.

    Of a damaged recording it is what can be read; what is missing is told, and exit code 1.
    """
    asked: dict[Format, bool] = {"csv": csv, "parquet": parquet}
    formats = [kind for kind, wanted in asked.items() if wanted]
    if not formats:
        raise ScenarioError("export: must be given --csv, --parquet, or both")
    data, _ = load_run(run_dir)
    own = run_dir if run_dir.is_dir() else run_dir.parent
    for file in export_series(data, out or own / "export", formats, names or SERIES):
        print(file)
    for sentence in _missing(data):
        print(sentence, file=sys.stderr)
    raise typer.Exit(FAULT if data.damage else FINISHED)


def _missing(run: RunData) -> list[str]:
    """What the files of a run lack, a sentence each."""
    found = [damaged(run.damage)] if run.damage else [] if run.complete else [PARTIAL]
    known = known_ticks(run)
    return [*found, missing_ticks_sentence(known)] if known.missing else found

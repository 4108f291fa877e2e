"""The commands `export` and `reference`: tables for other programs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import typer

from bus_schema.arrays import Vector
from bus_schema.errors import InputError, did_you_mean
from bus_schema.foreign_text import say
from deploy.cli.parts.options import Overrides, ScenarioArgument
from deploy.judge.bounds import all_damage
from deploy.judge.recorded_ticks import known_ticks
from deploy.judge.run_data import RunData
from deploy.judge.time_series import SERIES, series
from deploy.measure.trace_output import write_table
from deploy.reports.again import evaluated_again
from deploy.reports.paper.latex import write_latex
from deploy.reports.paper.paper import FORMATS, write_bibtex, write_figures
from deploy.reports.verdict_texts import PARTIAL, damaged, missing_ticks_sentence
from deploy.run.exit_codes import FAULT, FINISHED
from deploy.run.run_folder import load_run
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import ScenarioError

Format = Literal["csv", "parquet"]


def export(
    run_dir: Annotated[
        Path, typer.Argument(metavar="RESULT", help="Folder of a result, or MCAP file of a run.")
    ],
    csv: Annotated[bool, typer.Option("--csv", help="Write CSV files.")] = False,
    parquet: Annotated[bool, typer.Option("--parquet", help="Write Parquet files.")] = False,
    names: Annotated[
        list[str] | None,
        typer.Option("--series", metavar="NAME", help="Write only this series; repeatable."),
    ] = None,
    figures: Annotated[
        str | None,
        typer.Option(metavar="pdf,svg", help="Write the report's figures, for a paper."),
    ] = None,
    columns: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=2,
            help="Columns of the paper: a figure is as wide (default 1), a table at most (2).",
        ),
    ] = None,
    latex: Annotated[bool, typer.Option("--latex", help="Write the report's tables.")] = False,
    bibtex: Annotated[bool, typer.Option("--bibtex", help="Write a citation.")] = False,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the files; RESULT/export by default.")
    ] = None,
) -> None:
    """Write a result for other programs, and for a paper.

    --csv and --parquet write the time series of a run: the judged errors and bounds, and every
    topic. --figures, --latex and --bibtex write the figures and tables of any result's report,
    and a citation with version and digest. From a damaged recording, the command writes what it can
    read, reports what is missing, and ends with exit code 1.
    """
    asked: dict[Format, bool] = {"csv": csv, "parquet": parquet}
    formats = [kind for kind, wanted in asked.items() if wanted]
    pictures = [] if figures is None else figures.split(",")
    for each in pictures:
        if each not in FORMATS:
            raise ScenarioError(f"--figures {each[:40]}: must be {', '.join(FORMATS)}")
    if not (formats or pictures or latex or bibtex):
        wanted = "--csv, --parquet, --figures, --latex or --bibtex"
        raise ScenarioError(f"export: must be given one or more of {wanted}")
    if columns is not None and not (pictures or latex):
        raise ScenarioError("--columns: must be left out without --figures and --latex")
    if names and not formats:
        raise ScenarioError("--series: must be left out without --csv and --parquet")
    own = run_dir if run_dir.is_dir() else run_dir.parent
    folder = out or own / "export"
    if folder.exists() and not folder.is_dir():
        raise ScenarioError(f"--out {folder}: is a file: must be a folder")
    is_damaged = False
    if pictures or latex or bibtex:
        is_damaged = _export_for_paper(
            run_dir, folder, pictures, columns, latex=latex, bibtex=bibtex
        )
    if formats:
        data, _ = load_run(run_dir)
        for file in export_series(data, folder, formats, names or SERIES):
            print(file)
        is_damaged = _say_what_is_missing(data)
    raise typer.Exit(FAULT if is_damaged else FINISHED)


def _export_for_paper(
    path: Path,
    folder: Path,
    figures: Sequence[str],
    columns: int | None,
    *,
    latex: bool,
    bibtex: bool,
) -> bool:
    """Evaluate results again, write what a paper needs of them; return whether they are damaged."""
    results_folder, judge = evaluated_again(path)
    with results_folder.lock():
        results = judge()
    if results.page is None:
        raise ScenarioError(f"{path}: has no report, so no figures and tables")
    folder.mkdir(parents=True, exist_ok=True)
    for file in write_figures(results.page, folder, figures, columns or 1) if figures else ():
        print(file)
    if latex:
        print(write_latex(results.page, folder / "tables.tex", columns or 2))
    if bibtex:
        print(write_bibtex(results, results.page, folder / "citation.bib"))
    for run in results.runs:
        _say_what_is_missing(run.data)
    return results.is_damaged


def _say_what_is_missing(run: RunData) -> bool:
    """Report what is missing in the files of a run; return whether they are damaged."""
    damage = all_damage(run)
    for sentence in _missing(run, damage):
        say(sentence, err=True)
    return bool(damage)


def export_series(
    run: RunData, folder: Path, formats: Sequence[Format], names: Sequence[str] = SERIES
) -> list[Path]:
    """Write each series of a run to a file, and replace existing files.

    Args:
        run: the run.
        folder: where; made if it is not there.
        formats: of the files.
        names: which, of `SERIES`.

    Raises:
        ScenarioError: there is no series of a name.
        OSError: a file cannot be written.
    """
    for name in names:
        if name not in SERIES:
            allowed = f"must be one of {', '.join(SERIES)}{did_you_mean(name, SERIES)}"
            raise ScenarioError(f"--series {name[:100]}: {allowed}")
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for name in names:
        columns = series(run, name)
        for kind in formats:
            files.append(folder / f"{name}.{kind}")
            write_table(columns, files[-1], is_parquet=kind == "parquet")
    return files


def _missing(run: RunData, damage: list[str]) -> list[str]:
    """Describe in one sentence each what is missing in the files of a run."""
    found = [damaged(damage)] if damage else [] if run.complete else [PARTIAL]
    known = known_ticks(run)
    return [*found, missing_ticks_sentence(known)] if known.missing else found


def reference(
    scenario: ScenarioArgument,
    overrides: Overrides = None,
    as_csv: Annotated[bool, typer.Option("--csv", help="Write CSV, one row per tick.")] = False,
    as_parquet: Annotated[
        bool, typer.Option("--parquet", help="Write Parquet, one row per tick.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option(help="The file; by default <scenario>_reference.csv.")
    ] = None,
) -> None:
    """Write the reference of each joint at every tick: position, velocity and acceleration."""
    if as_csv == as_parquet:
        raise InputError("reference: give one of --csv and --parquet")
    setup = load_setup(scenario, overrides or [])
    kind: Format = "csv" if as_csv else "parquet"
    path = out or Path(f"{setup.scenario.name}_reference.{kind}")
    write_table(reference_columns(setup), path, is_parquet=as_parquet)
    print(path)


def reference_columns(setup: Setup) -> dict[str, Vector]:
    """Return the reference at every tick, by column.

    `time_s`, and for each joint `<joint>.position_rad`, `<joint>.velocity_rad_s` and
    `<joint>.acceleration_rad_s2`; shape (ticks + 1,) each.
    """
    times_s = np.array([setup.grid.tick_ns(tick) for tick in range(setup.ticks + 1)]) * 1e-9
    names = setup.robot.joint_names
    motion = np.empty((len(times_s), 3, len(names)))
    now = np.empty((3, len(names)))
    follow = setup.reference.onto(now[0], now[1], now[2])
    for row, time_s in enumerate(times_s.tolist()):
        follow(time_s)
        motion[row] = now
    kinds = ("position_rad", "velocity_rad_s", "acceleration_rad_s2")
    return {"time_s": times_s} | {
        f"{name}.{kind}": motion[:, k, j]
        for j, name in enumerate(names)
        for k, kind in enumerate(kinds)
    }

"""Tables for other programs: `export` of a run, `reference` of a scenario."""

from __future__ import annotations

import csv as csv_files
import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from bus_schema.arrays import Vector
from bus_schema.errors import InputError
from deploy.cli.options import Overrides, ScenarioArgument
from deploy.judge.recorded_ticks import known_ticks
from deploy.judge.run_data import RunData
from deploy.judge.time_series import SERIES
from deploy.reports.verdict import PARTIAL, damaged, missing_ticks_sentence
from deploy.run.exit_codes import FAULT, FINISHED
from deploy.run.export import Format, export_series
from deploy.run.run_folder import load_run
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
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


def reference(
    scenario: ScenarioArgument,
    overrides: Overrides = None,
    as_csv: Annotated[bool, typer.Option("--csv", help="As text, a row per tick.")] = False,
    as_parquet: Annotated[bool, typer.Option("--parquet", help="As a Parquet file.")] = False,
    out: Annotated[
        Path | None, typer.Option("--out", help="The file; by default <scenario>_reference.csv.")
    ] = None,
) -> None:
    """Write where the joints are to be at each tick: position, velocity and acceleration."""
    if as_csv == as_parquet:
        raise InputError("reference: give one of --csv and --parquet")
    setup = load_setup(scenario, overrides or [])
    ending = "csv" if as_csv else "parquet"
    path = out or Path(f"{setup.scenario.name}_reference.{ending}")
    columns = reference_columns(setup)
    (_write_csv if as_csv else _write_parquet)(columns, path)
    print(path)


def reference_columns(setup: Setup) -> dict[str, Vector]:
    """The reference at every tick, by column.

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


def _write_csv(columns: dict[str, Vector], path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv_files.writer(file)
        writer.writerow(columns)
        writer.writerows(np.column_stack(list(columns.values())).tolist())


def _write_parquet(columns: dict[str, Vector], path: Path) -> None:
    import pyarrow as pa  # heavy, and needed by few commands
    from pyarrow import parquet

    parquet.write_table(pa.table(columns), path)

"""The command `reference`: a scenario's reference as a file, for controllers written elsewhere."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from bus_schema.arrays import Vector
from deploy.cli.options import Overrides, ScenarioArgument
from deploy.input_error import InputError
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup


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
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(np.column_stack(list(columns.values())).tolist())


def _write_parquet(columns: dict[str, Vector], path: Path) -> None:
    import pyarrow as pa  # heavy, and needed by few commands
    from pyarrow import parquet

    parquet.write_table(pa.table(columns), path)

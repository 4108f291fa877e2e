"""The command `latency`: estimates dead time and lag of a recorded system."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from bus_schema.arrays import Vector
from bus_schema.errors import InputError, did_you_mean
from deploy.cli.network.trace import Unit
from deploy.run.measure.latency import find_latency
from deploy.run.measure.mcap_series import read_series
from deploy.run.measure.trace_import import UNITS_MS

_ELEMENT = re.compile(r"(.+)\[(\d+)\]")


def latency(
    file: Annotated[Path, typer.Argument(help="A CSV, Parquet or MCAP file.")],
    command: Annotated[
        str, typer.Option(help="Column of commands, as `action[2]`; in MCAP, `/topic.field[2]`.")
    ],
    response: Annotated[str, typer.Option(help="Column of responses, in the same form.")],
    time: Annotated[str, typer.Option(help="Column of times.")] = "time_s",
    unit: Annotated[Unit, typer.Option(help="Unit of the times.")] = Unit.S,
    linear: Annotated[
        bool,
        typer.Option(
            "--linear", help="Interpolate commands linearly between rows instead of holding them."
        ),
    ] = False,
    longest_ms: Annotated[
        float, typer.Option("--longest", metavar="MS", help="Largest dead time and lag to search.")
    ] = 500.0,
) -> None:
    """Estimate dead time and first-order lag from a recorded command and response.

    Both come with 95 % intervals. If a file has several episodes, the longest is used.
    """
    if file.suffix == ".mcap":
        if time != "time_s" or unit != Unit.S:
            raise InputError(f"{file}: --time and --unit are for tables: MCAP files have log times")
        times_s, commands, responses = read_series(file, command, response, is_held=not linear)
    else:
        table = _table(file)
        times_s, commands, responses = (
            _column(file, table, each) for each in (time, command, response)
        )
        times_s = times_s * (UNITS_MS[unit] / 1e3)
    starts = [0, *(np.flatnonzero(~(np.diff(times_s) > 0.0)) + 1).tolist(), len(times_s)]
    first, end = max(zip(starts, starts[1:], strict=False), key=lambda each: each[1] - each[0])  # noqa: RUF007
    rows = slice(first, end)
    try:
        found = find_latency(
            times_s[rows], commands[rows], responses[rows], longest_ms / 1e3, is_held=not linear
        )
    except ValueError as error:
        raise InputError(f"{file}: {command}, {response}: {error}") from error
    of = f" (the longest of {len(starts) - 1} episodes)" if len(starts) > 2 else ""
    seen_s = times_s[rows][np.isfinite(responses[rows])]
    rate_hz = 1.0 / float(np.median(np.diff(seen_s)))
    kept = "on lines" if linear else "held"
    print(f"{len(seen_s):,} rows at {rate_hz:.4g} Hz{of}; commands are {kept}")
    for name, (value, half), scale, suffix in (
        ("dead time", found.dead_time_s, 1e3, " ms"), ("lag", found.lag_s, 1e3, " ms"),
        ("gain", found.gain, 1.0, ""),
    ):  # fmt: skip
        print(f"{name}: {scale * value:.3f} ± {scale * half:.3f}{suffix}")
    print(f"explained: {100 * found.explained:.1f} % of the response's variance")


def _table(file: Path) -> Any:
    from pyarrow import ArrowException, csv, parquet  # heavy, and needed by few commands

    try:
        return parquet.read_table(file) if file.suffix == ".parquet" else csv.read_csv(file)
    except (ArrowException, OSError) as error:
        raise InputError(f"{file}: cannot be read: {error}") from error


def _column(file: Path, table: Any, name: str) -> Vector:
    """A column of finite numbers, or an element of a column of lists."""
    element = None if name in table.column_names else _ELEMENT.fullmatch(name)
    column = name if element is None else element[1]
    if column not in table.column_names:
        known = ", ".join(table.column_names)
        hint = did_you_mean(column, table.column_names)
        raise InputError(f"{file}: column {column!r} is missing; there are {known}{hint}")
    try:
        values = np.array(table[column].to_pylist(), dtype=np.float64)
        values = values if element is None else values[:, int(element[2])]
    except (ValueError, TypeError, IndexError) as error:
        raise InputError(f"{file}: {name}: must be numbers: {error}") from error
    if values.ndim != 1 or not np.isfinite(values).all():
        raise InputError(f"{file}: {name}: must be one finite number in each row")
    return values

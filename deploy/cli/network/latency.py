"""The command `latency`: estimates dead time and lag of a recorded system."""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer

from bus_schema.arrays import Vector
from bus_schema.errors import InputError
from bus_schema.tables import column_names, read_columns
from bus_schema.time_units import UNITS_MS, Unit, check_interval, units_of
from bus_schema.user_files import read_text
from deploy.measure.latency import Latency, find_latency
from deploy.measure.latency_export import ENDINGS, Export, exported
from deploy.measure.mcap_series import element_place, read_fields, rows_of

_Rows = tuple[Vector, Vector, Vector]
_ELEMENT = re.compile(r"(.+)\[([^\[\]]+)\]")
_TIMES = ("time_s", "t", "time", "timestamp")
_SAME = 0.05
"""Distance of the gain from 1, within which commands are targets of what the responses measure."""
_NO_POSITION = re.compile(r"effort|torque|current|vel|speed|acc|force|pwm", re.IGNORECASE)
_CLEARLY_LESS, _EXACT = 0.9, 1e-9
"""Of what one interpolation leaves unexplained: less than this with the other, and it is named."""


def latency(
    file: Annotated[Path, typer.Argument(help="A CSV, Parquet, MCAP or rosbag2 file.")],
    command: Annotated[
        str,
        typer.Option(
            help="Column of commands, as `action[2]`; in MCAP, `/topic.field[2]` or"
            r" `/topic.field\[joint]`."
        ),
    ],
    response: Annotated[str, typer.Option(help="Column of responses, in the same form.")],
    time: Annotated[
        str | None, typer.Option(help=r"Column of times.  \[default: time_s, t, time or timestamp]")
    ] = None,
    unit: Annotated[
        Unit | None,
        typer.Option(
            help=r"Unit of the times, if the name of their column does not say it.  \[default: s]"
        ),
    ] = None,
    linear: Annotated[
        bool,
        typer.Option(
            "--linear", help="Interpolate commands linearly between rows instead of holding them."
        ),
    ] = False,
    longest_ms: Annotated[
        float, typer.Option("--longest", metavar="MS", help="Largest dead time and lag to search.")
    ] = 500.0,
    export: Annotated[
        Export | None, typer.Option(help="Write the latency for this program.", show_default=False)
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help=r"File of --export.  \[default: <file>_latency.*]")
    ] = None,
) -> None:
    """Estimate dead time and first-order lag from a recorded command and response.

    Both come with 95 % intervals, as does their sum. If a file has several episodes, the longest is
    used.
    """
    if out is not None and export is None:
        raise InputError(f"latency: --out {out}: must be left out without --export")
    read = _read(file, command, response, time, unit)
    longest_s, (rows, others) = longest_ms / 1e3, read.rows[:: -1 if linear else 1]
    try:
        found, seen_s, episodes = _fitted(*rows, longest_s, is_held=not linear)
        check_interval(seen_s)
    except ValueError as error:
        why = "; ".join([str(error), *read.notes])
        raise InputError(f"{file}: {command}, {response}: {why}") from error
    try:
        other, *_ = _fitted(*others, longest_s, is_held=linear)
    except ValueError:
        other = None
    of = f" (the longest of {episodes} episodes)" if episodes > 1 else ""
    rate_hz = 1.0 / float(np.median(np.diff(seen_s)))
    kept = "on lines" if linear else "held"
    print(f"{len(seen_s):,} rows at {rate_hz:.4g} Hz{of}; commands are {kept}")
    print("".join(f"{each}\n" for each in read.notes), end="")
    _print(found, other, other_choice="without --linear" if linear else "with --linear")
    if found.misfit:
        print("".join(f"{each}\n" for each in read.doubts), end="")
    if export is not None:
        is_robot = export == Export.SCENARIO and _are_positions(found, command, response)
        if is_robot:
            found = _of_robot(found, rows, longest_s, is_held=not linear)
        _export(found, export, file, out, is_robot=is_robot)


class _Read(NamedTuple):
    """Commands and responses read from a file.

    Attributes:
        rows: times, commands and responses, with commands held and with commands on lines.
        notes: what was not read, a sentence each.
        doubts: reasons why the model may not fit, a sentence each.
    """

    rows: tuple[_Rows, _Rows]
    notes: Sequence[str] = ()
    doubts: Sequence[str] = ()


def _read(file: Path, command: str, response: str, time: str | None, unit: Unit | None) -> _Read:
    """Read a table, or a recording of ROS messages."""
    if not (file.is_dir() or file.suffix in (".mcap", ".db3")):
        times_s, commands, responses = _columns(file, time, unit, command, response)
        return _Read(((times_s, commands, responses),) * 2)
    if time is not None or unit is not None:
        raise InputError(f"{file}: --time and --unit are for tables: MCAP files have log times")
    fields = read_fields(file, command, response)
    held, on_lines = (rows_of(*fields, is_held=is_held) for is_held in (True, False))
    notes, doubts = ([*fields[0].notes, *fields[1].notes], [*fields[0].doubts, *fields[1].doubts])
    commanded, moved = (each.element for each in fields)
    if commanded and moved and commanded != moved and not (commanded + moved).isdecimal():
        notes.append(f"commands are those of {commanded}, responses those of {moved}")
    return _Read((held, on_lines), notes, doubts)


def _are_positions(found: Latency, *names: str) -> bool:
    """Whether a log has targets and the positions that follow them, by its gain and its names."""
    return abs(found.gain[0] - 1.0) < _SAME and not any(_NO_POSITION.search(each) for each in names)


def _of_robot(found: Latency, rows: _Rows, longest_s: float, *, is_held: bool) -> Latency:
    """Return the latency of a robot: of second order where that fits better."""
    try:
        second, *_ = _fitted(*rows, longest_s, is_held=is_held, order=2)
    except ValueError:
        return found
    if second.explained <= found.explained:
        return found
    times_ms = (1e3 * each for each in (*second.dead_time_s, *second.lag_s))
    words = "dead time {:.3f} ± {:.3f} ms, lag {:.3f} ± {:.3f} ms".format(*times_ms)
    print(f"of second order, as a robot that follows positions: {words}")
    return second


def _export(
    found: Latency, export: Export, file: Path, out: Path | None, *, is_robot: bool
) -> None:
    """Write what was found for another program, and print the file's name."""
    if found.misfit:
        raise InputError(f"{file}: --export {export}: the model does not fit")
    path = out or Path(f"{file.stem}_latency{ENDINGS[export]}")
    try:
        path.write_text(exported(found, export, file.name, is_robot=is_robot), encoding="utf-8")
    except OSError as error:
        raise InputError(f"--out {path}: cannot be written: {error.strerror}") from error
    print(f"{export}: {path}")


def _print(found: Latency, other: Latency | None, other_choice: str) -> None:
    """Print what was found, whether the model fits, and whether the other interpolation does."""
    for name, (value, half), scale, suffix in (
        ("dead time", found.dead_time_s, 1e3, " ms"), ("lag", found.lag_s, 1e3, " ms"),
        ("together", found.together_s, 1e3, " ms, the delay that slow motions show"),
        ("gain", found.gain, 1.0, ""),
    ):  # fmt: skip
        interval = "" if found.misfit else f" ± {scale * half:.3f}"
        print(f"{name}: {scale * value:.3f}{interval}{suffix}")
    print(f"explained: {100 * found.explained:.3f} % of the response's variance")
    if found.misfit:
        print(f"the model does not fit, so there are no intervals: {found.misfit}")
    left, left_by_other = (1.0 - each.explained if each else 1.0 for each in (found, other))
    if left_by_other < _CLEARLY_LESS * left and left > _EXACT:
        print(f"{other_choice} the model fits better: it leaves {100 * left_by_other:.2g} %,"
              f" not {100 * left:.2g} %, of the response's variance")  # fmt: skip


def _fitted(
    times_s: Vector, commands: Vector, responses: Vector, longest_s: float, *, is_held: bool,
    order: int = 1,
) -> tuple[Latency, Vector, int]:  # fmt: skip
    """Return the latency in the longest episode, its times of responses, and how many there are.

    Raises:
        ValueError: the rows do not say.
    """
    starts = [0, *(np.flatnonzero(~(np.diff(times_s) > 0.0)) + 1).tolist(), len(times_s)]
    rows = slice(*max(itertools.pairwise(starts), key=lambda each: each[1] - each[0]))
    found = find_latency(
        times_s[rows], commands[rows], responses[rows], longest_s, is_held=is_held, order=order
    )
    return found, times_s[rows][np.isfinite(responses[rows])], len(starts) - 1


def _columns(file: Path, time: str | None, unit: Unit | None, *names: str) -> Iterator[Vector]:
    """Yield the columns of times in s and of these names, of finite numbers alone.

    An element of a column of lists may be given by its name in the data set.
    """
    try:
        known = column_names(file)
        time = time or next((each for each in _TIMES if each in known), _TIMES[0])
        wanted = [time, *(_numbered(file, each, known) for each in names)]
        to_s = UNITS_MS[units_of([time], unit, f"{file}: --unit")[time]] / 1e3
        columns = read_columns(file, list(dict.fromkeys(wanted)), None)
        for name in wanted:
            allowed = "must be one finite number in each row"
            columns.refuse_where(~np.isfinite(columns.values[name]), name, allowed)
            yield columns.values[name] * (to_s if name == time else 1.0)
    except ValueError as error:
        raise InputError(str(error)) from error


def _numbered(file: Path, name: str, known: Sequence[str]) -> str:
    """Return the name of a column, whose element is given by number or by its name."""
    element = None if name in known else _ELEMENT.fullmatch(name)
    if element is None:
        return name
    return f"{element[1]}[{element_place(element[2], _names(file, element[1]))}]"


def _names(file: Path, column: str) -> list[str]:
    """Return the names of a column's elements in the data set's ``meta/info.json``, as LeRobot's.

    Raises:
        ValueError: it cannot be read.
    """
    infos = (folder / "meta" / "info.json" for folder in file.absolute().parents)
    info = next((each for each in infos if each.is_file()), None)
    features = {} if info is None else json.loads(read_text(info)).get("features", {})
    names: Any = features.get(column, {}).get("names") or []
    return next(iter(names.values()), []) if isinstance(names, dict) else names

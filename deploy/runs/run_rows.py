"""Runs as rows of a table: what experiments over several runs leave as a Parquet file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bus_schema.percentiles import PERCENTILES
from bus_schema.recording.atomic_files import complete, naming_file, new_partial

_DIRECTIONS = ("uplink", "downlink")
_COUNTS = {"sent": "int64", "delivered": "int64", "lost": "int64"}
_DELAYS = {f"delay_{name}_ms": "double" for name in ("mean", *PERCENTILES)}
_COLUMNS = {
    "scenario": "string",
    "law": "string",
    "seed": "int64",
    "duration_s": "double",
    "ticks": "int64",
    "completed": "bool",
    "error": "string",
    "bounds_kept": "bool",
    "violation_fraction": "double",
    "first_violation_s": "double",
    "margin_min": "double",
    "joint_names": "list<string>",
    "rms_rad": "list<double>",
    "max_abs_rad": "list<double>",
    "settling_time_s": "list<double>",
    "settling_bound_s": "list<double>",
    "total_variation_nm_per_s": "list<double>",
    "share_above_50_hz": "list<double>",
    "rms_nm": "list<double>",
    "peak_nm": "list<double>",
    "saturated_fraction": "double",
    "deadline_misses": "int64",
    "success_rate": "double",
    **{
        f"{direction}_{name}": kind
        for direction in _DIRECTIONS
        for name, kind in {**_COUNTS, **_DELAYS}.items()
    },
    "digest": "string",
}
"""Names and types, units as in ``summary.json``; lists have one entry for each joint."""

Row = dict[str, Any]


def row(summary: dict[str, Any], seed: int) -> Row:
    """A run as a row; `error` holds its faults, null for none.

    Args:
        summary: the run's ``summary.json``.
        seed: the scenario's seed.
    """
    values: Row = {}
    for section in ("bounds", "tracking", "torque", "timing"):
        values |= summary[section]
    error = "; ".join(summary["faults"]) or None
    values |= summary | {"seed": seed, "error": error, "bounds_kept": summary["bounds"]["kept"]}
    for direction in _DIRECTIONS:
        values |= _link_statistics(direction, summary["transport"][direction])
    bound = values["settling_bound_s"]
    if bound is not None and not isinstance(bound, list):
        values["settling_bound_s"] = [bound] * len(values["joint_names"])
    return {name: values[name] for name in _COLUMNS}


def held(row: Row) -> bool:
    """Whether a run came to its end, without a fault and inside its bounds."""
    return bool(row["completed"]) and row["error"] is None and bool(row["bounds_kept"])


def _link_statistics(direction: str, channel: Mapping[str, Any]) -> Row:
    """Counts and delays of one direction, by their columns."""
    delays = {f"delay_{name}_ms": value for name, value in channel["delay_ms"].items()}
    counts = {name: channel[name] for name in _COUNTS}
    return {f"{direction}_{name}": value for name, value in {**counts, **delays}.items()}


def failed_row(seed: int, error: str) -> Row:
    """The row of a run that left nothing to judge."""
    return dict.fromkeys(_COLUMNS) | {"seed": seed, "completed": False, "error": error}


def write_rows(
    rows: Sequence[Row],
    path: Path,
    more_columns: Mapping[str, str] | None = None,
    conditions: Mapping[str, str] | None = None,
) -> None:
    """Write rows to a Parquet file; an existing one is replaced as a whole or not at all.

    Args:
        rows: what to write.
        path: the file.
        more_columns: names and types of columns in front of those that every run has.
        conditions: under which they came about, for the metadata of the schema.
    """
    import pyarrow as pa  # heavy, and needed by few commands
    from pyarrow import parquet

    def arrow_type(kind: str) -> Any:
        item = kind.removeprefix("list<").removesuffix(">")
        return pa.type_for_alias(item) if item == kind else pa.list_(pa.type_for_alias(item))

    columns = {**(more_columns or {}), **_COLUMNS}
    schema = pa.schema(
        [(name, arrow_type(kind)) for name, kind in columns.items()], metadata=conditions
    )
    with naming_file(path):
        parquet.write_table(pa.Table.from_pylist(list(rows), schema=schema), new_partial(path))
    complete(path)


def read_rows(path: Path) -> list[Row]:
    """Rows of a Parquet file."""
    from pyarrow import parquet

    rows: list[Row] = parquet.read_table(path).to_pylist()
    return rows

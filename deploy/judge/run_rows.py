"""Runs as rows of a table, which experiments over several runs write to a Parquet file."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from bus_schema.arrays import PERCENTILES
from bus_schema.recording.atomic_files import complete, naming_file, new_partial
from bus_schema.user_files import open_parquet
from deploy.judge.findings.reasons import Reason
from deploy.judge.verdict import Verdict, decide
from deploy.scenario.yaml_files import ScenarioError

_OF_DIRECTION = (
    *(("int64", name, name) for name in ("sent", "delivered", "lost")),
    *(("double", f"delay_{name}_ms", f"delay_ms.{name}") for name in ("mean", *PERCENTILES)),
)
"""Type and name of columns of each direction, and their keys."""


class Column(NamedTuple):
    """A column of a table of runs, in the units of ``summary.json``.

    Attributes:
        kind: its Parquet type; lists have one entry for each joint.
        at: keys of its value in ``summary.json``, by dots; empty for its own name.
        of_any_part: whether a run has it that ended at its loss; the others are for whole runs.
    """

    kind: str
    at: str = ""
    of_any_part: bool = False


_of_any_part = partial(Column, of_any_part=True)
_COLUMNS = {
    "scenario": _of_any_part("string"),
    "law": _of_any_part("string"),
    "seed": _of_any_part("int64"),
    "duration_s": _of_any_part("double"),
    "ticks": _of_any_part("int64"),
    "completed": _of_any_part("bool"),
    "ended_early_s": _of_any_part("double"),
    "error": _of_any_part("string"),
    "verdict": _of_any_part("string"),
    "seed_used": _of_any_part("bool"),
    "growing": Column("bool"),
    "vibrating": Column("bool"),
    "not_tested_below_hz": Column("double"),
    "bounds_kept": _of_any_part("bool", "bounds.kept"),
    "violation_fraction": Column("double", "bounds.violation_fraction"),
    "first_violation_s": _of_any_part("double", "bounds.first_violation_s"),
    "loss_reason": _of_any_part("string", "loss.reason"),
    "loss_joint": _of_any_part("string", "loss.joint"),
    "margin_min": Column("double", "bounds.margin_min"),
    "joint_names": _of_any_part("list<string>", "tracking.joint_names"),
    "rms_rad": Column("list<double>", "tracking.rms_rad"),
    "max_abs_rad": Column("list<double>", "tracking.max_abs_rad"),
    "tip_rms_mm": Column("double", "tip_error_mm.rms"),
    "tip_largest_mm": Column("double", "tip_error_mm.largest"),
    "settling_time_s": Column("list<double>", "tracking.settling_time_s"),
    "settling_bound_s": _of_any_part("list<double>", "tracking.settling_bound_s"),
    **{
        name: Column("list<double>", f"torque.{name}")
        for name in ("total_variation_nm_per_s", "share_above_50_hz", "rms_nm", "peak_nm")
    },
    "saturated_fraction": Column("double", "torque.saturated_fraction"),
    "deadline_misses": Column("int64", "timing.deadline_misses"),
    "success_rate": Column("double", "timing.success_rate"),
    **{
        f"{way}_{name}": Column(kind, f"transport.{way}.{at}")
        for way in ("uplink", "downlink")
        for kind, name, at in _OF_DIRECTION
    },
    "digest": _of_any_part("string"),
    "motion": Column("string"),
}
"""Columns by their names."""

_FLAWS = {"growing": Reason.GROWING, "vibrating": Reason.VIBRATION}
"""Columns that are true for runs that do not hold although they kept their bounds, and why."""
PROVENANCE = "provenance"
"""Column that says what made a row, see `deploy.study.execution.provenance`."""
Row = dict[str, Any]
_DIGEST = b"funnel_hil.sha256"
"""In the schema's metadata: checksum of names, rows and conditions."""


def row(summary: dict[str, Any], seed: int) -> Row:
    """Return a run as a row; `error` holds its faults, null for none.

    Args:
        summary: the run's ``summary.json``.
        seed: the scenario's seed.
    """
    values = {name: _value(summary, column.at or name) for name, column in _COLUMNS.items()}
    values |= {"seed": seed, "error": "; ".join(summary["faults"]) or None}
    values |= {name: bool(summary.get(name)) for name in _FLAWS}
    bound = values["settling_bound_s"]
    if bound is not None and not isinstance(bound, list):
        values["settling_bound_s"] = [bound] * len(values["joint_names"])
    return values


def _value(summary: Mapping[str, Any], at: str) -> Any:
    """Return a value in a summary; None where it, or a part around it, is missing."""
    found: Any = summary
    for key in at.split("."):
        found = found.get(key) if isinstance(found, Mapping) else None
    return found


def early_row(row: Row) -> Row:
    """Return the row of a run that ended soon after its loss, without what only whole runs have."""
    found = {name: row[name] for name, column in _COLUMNS.items() if column.of_any_part}
    return {**dict.fromkeys(row), **found, "ended_early_s": row["duration_s"]}


def is_whole(row: Row) -> bool:
    """Whether a run was not ended at its loss."""
    return row.get("ended_early_s") is None


def held(row: Row) -> bool:
    """Whether a run kept its bounds."""
    return bool(row["verdict"] == Verdict.KEPT)


def tolerated(row: Row) -> bool:
    """Whether a run kept its bounds, and its loop neither grew nor vibrated within them."""
    return held(row) and not any(row.get(name) for name in _FLAWS)


def reason_of(row: Row) -> str | None:
    """Return the `Reason` why a run is not tolerated; None if it is, or is not known."""
    lost: str | None = row.get("loss_reason")
    flaws = (reason.value for name, reason in _FLAWS.items() if row.get(name))
    return lost or next(flaws, None)


def left_nothing(row: Row) -> bool:
    """Whether a run left nothing to judge: it shows nothing about its law."""
    return row["error"] is not None and row["violation_fraction"] is None and is_whole(row)


def uses_seed(row: Row) -> bool:
    """Whether another seed may change a run; also where that is not known."""
    return row.get("seed_used") is not False


def failed_row(seed: int, error: str) -> Row:
    """Return the row of a run that left nothing to judge."""
    found = {"seed": seed, "completed": False, "error": error, "verdict": decide([error]).value}
    return dict.fromkeys(_COLUMNS) | found


def write_rows(
    rows: Sequence[Row],
    path: Path,
    more_columns: Mapping[str, str] | None = None,
    conditions: Mapping[str, str] | None = None,
) -> None:
    """Write rows to a Parquet file; an existing one is replaced as a whole or not at all.

    Args:
        rows: the rows.
        path: the file.
        more_columns: names and types of columns in front of those that every run has.
        conditions: their conditions, for the metadata of the schema.
    """
    import pyarrow as pa  # heavy, and needed by few commands
    from pyarrow import parquet

    def arrow_type(kind: str) -> Any:
        item = kind.removeprefix("list<").removesuffix(">")
        return pa.type_for_alias(item) if item == kind else pa.list_(pa.type_for_alias(item))

    own = {name: column.kind for name, column in _COLUMNS.items()}
    columns = {**(more_columns or {}), **own, PROVENANCE: "string"}
    schema = pa.schema(
        [(name, arrow_type(kind)) for name, kind in columns.items()], metadata=conditions
    )
    table = pa.Table.from_pylist(list(rows), schema=schema)
    metadata = {**(table.schema.metadata or {}), _DIGEST: _digest(table)}
    with naming_file(path):
        parquet.write_table(table.replace_schema_metadata(metadata), new_partial(path))
    complete(path)


def read_rows(path: Path) -> list[Row]:
    """Return the rows of a Parquet file.

    Raises:
        ScenarioError: it is damaged, or of an older version.
    """
    try:
        table = open_parquet(path).read()
        table.validate(full=True)
        digest = (table.schema.metadata or {}).get(_DIGEST)
        rows: list[Row] = table.to_pylist()
        is_whole = digest == _digest(table)
    except Exception as error:  # the exceptions that pyarrow raises on damage have no common class
        reason = str(error).partition("\n")[0] or type(error).__name__
        raise ScenarioError(f"{path}: cannot be read: {reason}") from error
    if digest is None:
        raise ScenarioError(f"{path}: has no checksum: must be a table of this version")
    if not is_whole:
        raise ScenarioError(f"{path}: is damaged: its rows do not match their checksum")
    return rows


def _digest(table: Any) -> bytes:
    """Return a checksum of a table's content, independent of the file's format."""
    metadata = {k: v for k, v in (table.schema.metadata or {}).items() if k != _DIGEST}
    contents = repr((table.column_names, sorted(metadata.items()), table.to_pylist()))
    return hashlib.sha256(contents.encode()).hexdigest().encode()

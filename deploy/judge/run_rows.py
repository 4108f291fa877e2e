"""Runs as rows of a table, which experiments over several runs write to a Parquet file."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bus_schema.recording.atomic_files import complete, naming_file, new_partial
from bus_schema.user_files import open_parquet
from deploy.judge.findings.loss_reason import Reason
from deploy.judge.metrics import RunResult
from deploy.judge.result.section import figures
from deploy.judge.verdict import Verdict, decide
from deploy.scenario.yaml_files import ScenarioError

_FIGURES = {name: each for each in figures(RunResult) for name in each.columns}
_PATHS = {name: each.columns[name] for name, each in _FIGURES.items()}
COLUMNS = {
    **{name: each.kind for name, each in _FIGURES.items()},
    "seed": "int64", "ended_early_s": "double", "error": "string",
}  # fmt: skip
"""Parquet types of the columns of every table of runs, by name: most are figures of a result."""

_FLAWS = {"growing": Reason.GROWING, "vibrating": Reason.VIBRATION}
"""Columns that are true for runs that do not hold although they kept their bounds, and why."""
PROVENANCE = "provenance"
"""Column that says what made a row, see `deploy.study.execution.provenance`."""
Row = dict[str, Any]
_DIGEST = b"funnel_hil.sha256"
"""In the schema's metadata: checksum of names, rows and conditions."""


def row(result: RunResult, seed: int) -> Row:
    """Return a run as a row; `error` holds its faults, null for none.

    Args:
        result: the result of the run.
        seed: the scenario's seed.
    """
    summary, joints = result.model_dump(), len(result.tracking.joint_names)
    values = {name: _value(summary, at, COLUMNS[name], joints) for name, at in _PATHS.items()}
    error = "; ".join(result.faults) or None
    return {**values, "seed": seed, "ended_early_s": None, "error": error}


def _value(summary: Mapping[str, Any], path: Sequence[str], kind: str, joints: int) -> Any:
    """Return a value in a summary as its column has it; None where a part around it is missing."""
    found: Any = summary
    for key in path:
        found = found.get(key) if isinstance(found, Mapping) else None
    if kind.startswith("list") and isinstance(found, float):  # the same for all joints
        return [found] * joints
    return bool(found) if isinstance(found, list) and kind == "bool" else found


def early_row(row: Row) -> Row:
    """Return the row of a run that ended soon after its loss, without what only whole runs have."""
    found = {
        name: value for name, value in row.items()
        if name not in _FIGURES or _FIGURES[name].is_of_any_part
    }  # fmt: skip
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
    return dict.fromkeys(COLUMNS) | found


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

    columns = {**(more_columns or {}), **COLUMNS, PROVENANCE: "string"}
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

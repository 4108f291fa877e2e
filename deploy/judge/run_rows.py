"""Runs as rows of a table, which experiments over several runs write to a Parquet file."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bus_schema.arrays import PERCENTILES
from bus_schema.recording.atomic_files import complete, naming_file, new_partial
from bus_schema.user_files import open_parquet
from deploy.judge.findings.reasons import Reason
from deploy.judge.verdict import Verdict, decide
from deploy.scenario.yaml_files import ScenarioError

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
    "ended_early_s": "double",
    "error": "string",
    "verdict": "string",
    "seed_used": "bool",
    "growing": "bool",
    "vibrating": "bool",
    "not_tested_below_hz": "double",
    "bounds_kept": "bool",
    "violation_fraction": "double",
    "first_violation_s": "double",
    "loss_reason": "string",
    "loss_joint": "string",
    "margin_min": "double",
    "joint_names": "list<string>",
    "rms_rad": "list<double>",
    "max_abs_rad": "list<double>",
    "tip_rms_mm": "double",
    "tip_largest_mm": "double",
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
    "motion": "string",
}
"""Names and types, units as in ``summary.json``; lists have one entry for each joint."""

_OF_ANY_PART = {
    *("scenario", "law", "seed", "duration_s", "ticks", "completed", "ended_early_s", "error"),
    *("verdict", "seed_used", "bounds_kept", "first_violation_s", "loss_reason", "loss_joint"),
    *("joint_names", "settling_bound_s", "digest"),
}
"""Columns that a run has that ended at its loss; the others are for whole runs."""

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
    values: Row = {}
    for section in ("bounds", "tracking", "torque", "timing"):
        values |= summary[section]
    error = "; ".join(summary["faults"]) or None
    # which older versions lack, and runs that a study has not ended
    lacking = ("motion", "seed_used", "ended_early_s", "not_tested_below_hz")
    values |= dict.fromkeys(lacking) | summary
    values |= {"seed": seed, "error": error, "bounds_kept": summary["bounds"]["kept"]}
    loss = summary.get("loss") or {}
    values |= {"loss_reason": loss.get("reason"), "loss_joint": loss.get("joint")}
    tip = summary.get("tip_error_mm") or {}
    values |= {f"tip_{name}_mm": tip.get(name) for name in ("rms", "largest")}
    values |= {name: bool(summary.get(name)) for name in _FLAWS}
    for direction in _DIRECTIONS:
        channel = summary["transport"][direction]
        delays = {f"delay_{name}_ms": value for name, value in channel["delay_ms"].items()}
        statistics = {**{name: channel[name] for name in _COUNTS}, **delays}
        values |= {f"{direction}_{name}": value for name, value in statistics.items()}
    bound = values["settling_bound_s"]
    if bound is not None and not isinstance(bound, list):
        values["settling_bound_s"] = [bound] * len(values["joint_names"])
    return {name: values[name] for name in _COLUMNS}


def early_row(row: Row) -> Row:
    """Return the row of a run that ended soon after its loss, without what only whole runs have."""
    found = {name: value for name, value in row.items() if name in _OF_ANY_PART}
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

    columns = {**(more_columns or {}), **_COLUMNS, PROVENANCE: "string"}
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

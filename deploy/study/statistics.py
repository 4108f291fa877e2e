"""Several runs of one point of a study, summed up."""

from __future__ import annotations

import itertools
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from deploy.judge.findings.loss_reason import Reason
from deploy.judge.run_rows import PROVENANCE, Row, held, is_whole, reason_of

NO_EFFECT = "none of its values changed any result of a run"


def spread_of_runs(rows: Sequence[Row]) -> dict[str, Any]:
    """Return common values and spread of runs that differ in seed or start.

    If one has ended at its loss, the spread of what only whole runs have is unknown.
    """
    whole = rows if all(map(is_whole, rows)) else []
    return {
        "runs": len(rows),
        "runs_kept": sum(held(row) for row in rows),
        "runs_growing": sum(bool(row.get("growing")) for row in rows),
        "runs_vibrating": sum(bool(row.get("vibrating")) for row in rows),
        "losses": dict(Counter(filter(None, map(reason_of, rows)))),
        "loss_joints": dict(Counter(filter(None, (row.get("loss_joint") for row in rows)))),
        "runs_failed": sum(row["error"] is not None for row in rows),
        "not_tested_below_hz": max(
            (hertz for row in rows if (hertz := row.get("not_tested_below_hz"))), default=None
        ),
        "first_violation_s": spread([row.get("first_violation_s") for row in rows]),
        "violation_fraction": spread([row["violation_fraction"] for row in whole]),
        "margin_min": spread([row["margin_min"] for row in whole]),
        "worst_rms_rad": spread([worst(row["rms_rad"]) for row in whole]),
        "worst_total_variation_nm_per_s": spread(
            [worst(row["total_variation_nm_per_s"]) for row in whole]
        ),
    }


def commonest_error(rows: Sequence[Row]) -> str | None:
    """Return the most frequent first error of runs; differences in numbers are ignored."""
    by_kind: dict[str, list[str]] = {}
    for row in rows:
        if row["error"] is not None:
            cause = row["error"].partition("; ")[0]  # its consequences may differ
            by_kind.setdefault(re.sub(r"\d+", "0", cause), []).append(cause)
    return max(by_kind.values(), key=len)[0] if by_kind else None


def seeds_of(rows: Sequence[Row]) -> list[int]:
    """Return the seeds of runs, in order: without randomness, one may stand for all requested."""
    return sorted({row["seed"] for row in rows})


def in_order(rows: list[Row]) -> list[Row]:
    """Return rows by point and seed, in any order of execution."""
    return sorted(rows, key=lambda row: (row["point"], row["seed"]))


def badness(row: Row) -> tuple[bool, bool, float, float]:
    """Return a sort key for the worst of several runs.

    Failed ones are the worst, then lost ones, with most ticks outside, or lost first.
    """
    outside, lost_s = row["violation_fraction"] or 0.0, row.get("first_violation_s")
    return (
        row["error"] is not None,
        not held(row),
        outside,
        -math.inf if lost_s is None else -lost_s,
    )


def without_effect(
    rows: Sequence[Row], varied: Iterable[tuple[str, ...]], columns: Iterable[str]
) -> list[str]:
    """Return varied values that changed no result of any judged run.

    Args:
        rows: rows of the runs.
        varied: columns that took each value together.
        columns: all columns that identify a run, except point and seed.
    """
    inputs = {"point", "seed", *columns}
    # Until a command acts, all runs are alike.
    sound = [row for row in rows if row["error"] is None and row.get("loss_reason") != Reason.START]
    results = [
        {key: row[key] for key in row.keys() - inputs - {PROVENANCE} if row[key] is not None}
        for row in sound
    ]
    idle = []
    for keys in varied:
        others = sorted(inputs - {"point", *keys})
        first: dict[str, dict[str, Any]] = {}
        same = [
            first.setdefault(repr([row[key] for key in others]), result) == result
            for row, result in zip(sound, results, strict=True)
        ]
        if len(first) < len(sound) and all(same):
            idle.append(", ".join(keys))
    return idle


def kept_up_to(
    rows: Iterable[Row], column: str, values: Iterable[float], is_kept: Callable[[Row], bool]
) -> float | None:
    """Return the largest of rising values up to which all runs are kept; None for none."""
    kept: dict[float, bool] = {}
    for row in rows:
        kept[row[column]] = kept.get(row[column], True) and is_kept(row)
    return max(itertools.takewhile(kept.get, values), default=None)


def worst(values: Sequence[float | None] | None) -> float | None:
    """Return the largest of all joints, or None if one of them is unknown."""
    known = [value for value in values or () if value is not None]
    return max(known) if values and len(known) == len(values) else None


def spread(values: Sequence[float | None]) -> dict[str, float | None]:
    """Return mean and extremes of the known and finite values; null without any."""
    known = [value for value in values if value is not None and math.isfinite(value)]
    if not known:
        return {"mean": None, "lowest": None, "highest": None}
    return {"mean": math.fsum(known) / len(known), "lowest": min(known), "highest": max(known)}

"""Findings about the runs of a merge: the largest inference time; jumps, jerk and ages at one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from deploy.judge.run_rows import Row, held, tolerated
from deploy.study.statistics import worst
from deploy.study.study import rows_by

_WORST = {
    "jump_rad": "jump_rad", "jump_mm": "jump_mm", "jerk_rad_s3": "jerk_rad_s3",
    "jerk_rms_rad_s3": "jerk_rms_rad_s3", "age_median_ms": "age_median_ms",
    "age_largest_ms": "age_largest_ms", "starved_share": "starved_share",
    "tip_error_rms_mm": "tip_rms_mm",
}  # fmt: skip
"""Figures of a point, and the columns of its runs of which they are the largest."""


def case_findings(
    tags: Mapping[str, Any], rows: list[Row], times_ms: Sequence[float], at_ms: float
) -> dict[str, Any]:
    """Return what the runs of a merge on an arm say.

    Args:
        tags: what identifies the merge.
        rows: its runs so far.
        times_ms: inference times that are tried with it, rising.
        at_ms: inference time for comparisons; the largest one below it is used.
    """
    by_time = {time_ms: [r for r in rows if r["inference_ms"] == time_ms] for time_ms in times_ms}
    points = [_point(time_ms, own) for time_ms, own in by_time.items() if own]
    compared = next((each for each in reversed(points) if each["inference_ms"] <= at_ms), None)
    largest_ms, ends = _largest(by_time)
    return {
        **tags,
        "inference_ms": largest_ms,
        "is_limit": largest_ms == times_ms[-1],
        "ends": ends,
        "of_tasks_ms": _of_tasks(rows, times_ms),
        "at": compared,
        "points": points,
    }


def recommended(cases: Sequence[Mapping[str, Any]]) -> Mapping[str, Any] | None:
    """Return the merge for the inference time of comparisons; None if none keeps the bounds.

    Of those that keep them there, it jumps least, then with the least jerk. If none does, it is the
    one that keeps them longest.
    """
    able = [case for case in cases if case["inference_ms"] is not None]
    jump_key = jump_column(cases)

    def rank(case: Mapping[str, Any]) -> tuple[float, ...]:
        at, time_ms = case["at"] or {}, case["inference_ms"]
        kept_ms = min(time_ms, at.get("inference_ms", 0.0))
        jump = round(at.get(jump_key) or 0.0, 6)
        sizes = (jump, at.get("jerk_rms_rad_s3"))
        return (-kept_ms, *(float(f"{size or 0.0:.2g}") for size in sizes), -time_ms)

    return min(able, key=rank, default=None)


def jump_column(cases: Sequence[Mapping[str, Any]]) -> str:
    """Return in which unit jumps are compared: in rad where no jump moves the tip."""
    sizes_mm = [case["at"]["jump_mm"] for case in cases if case["at"]]
    return "jump_mm" if any(sizes_mm) and None not in sizes_mm else "jump_rad"


def longest(cases: Sequence[Mapping[str, Any]]) -> Mapping[str, Any]:
    """Return the merge that keeps the bounds up to the largest inference time; one has to."""
    return max(cases, key=lambda case: case["inference_ms"] or 0.0)


def _point(time_ms: float, rows: list[Row]) -> dict[str, Any]:
    largest = {name: worst([row.get(column) for row in rows]) for name, column in _WORST.items()}
    return {
        "inference_ms": time_ms,
        "runs": len(rows),
        "runs_kept": sum(map(held, rows)),
        "ends": _reason(rows),
        "worst_point": min(rows, key=tolerated)["point"],
        **{name: None if each is None else round(each, 9) for name, each in largest.items()},
    }


def _reason(rows: Sequence[Row]) -> str | None:
    """Return the commonest reason of a loss; None for none."""
    reasons = Counter(row["loss_reason"] for row in rows if row.get("loss_reason"))
    return reasons.most_common(1)[0][0] if reasons else None


def _largest(by_time: Mapping[float, list[Row]]) -> tuple[float | None, str | None]:
    """Return the inference time up to which all runs are tolerated, and what ends it."""
    largest_ms = None
    for time_ms, rows in by_time.items():
        if not rows or not all(map(tolerated, rows)):
            return largest_ms, _reason(rows)
        largest_ms = time_ms
    return largest_ms, None


def _of_tasks(rows: list[Row], times_ms: Sequence[float]) -> dict[str, Any] | None:
    """Return smallest, median and largest of the tasks' largest inference times; None for one.

    Of a task that is lost without any, that time is None.
    """
    by_task = rows_by((row for row in rows if row.get("task") is not None), lambda r: r["task"])
    if len(by_task) < 2:
        return None
    found = sorted(
        (
            _largest({t: [r for r in own if r["inference_ms"] == t] for t in times_ms})[0]
            for own in by_task.values()
        ),
        key=lambda time_ms: -1.0 if time_ms is None else time_ms,
    )
    return {
        "tasks": len(found), "smallest": found[0], "median": found[(len(found) - 1) // 2],
        "largest": found[-1],
    }  # fmt: skip

"""Findings about the runs of a merge: the largest inference time; jumps, jerk and ages at one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from deploy.judge.run_rows import Row, held, reason_of, tolerated
from deploy.reports.tables import shown_in
from deploy.studies.policy.result import Merge, OfTasks, Point
from deploy.study.statistics import worst
from deploy.study.study import rows_by

_OTHER_COLUMNS = {"tip_error_rms_mm": "tip_rms_mm"}
"""Columns of runs whose names differ from those of the figures that are the largest of them."""


def merge_findings(
    arm: str, merge: str, rows: list[Row], times_ms: Sequence[float], at_ms: float, *,
    is_whole: bool,
) -> Merge:  # fmt: skip
    """Return what the runs of a merge on an arm say.

    Args:
        arm: the arm.
        merge: the merge.
        rows: its runs so far.
        times_ms: inference times that are tried with it, rising.
        at_ms: inference time for comparisons; the largest one below it is used.
        is_whole: whether `times_ms` reach the limit of the study.
    """
    by_time = {time_ms: [r for r in rows if r["inference_ms"] == time_ms] for time_ms in times_ms}
    points = [_point(time_ms, own) for time_ms, own in by_time.items() if own]
    largest_ms, ends = _largest(by_time)
    return Merge(
        arm=arm, merge=merge, is_whole=is_whole, inference_ms=largest_ms,
        is_limit=largest_ms == times_ms[-1], ends=ends, of_tasks_ms=_of_tasks(rows, times_ms),
        at=next((each for each in reversed(points) if each.inference_ms <= at_ms), None),
        points=points,
    )  # fmt: skip


def recommended(cases: Sequence[Merge]) -> Merge | None:
    """Return the merge for the inference time of comparisons; None if none keeps the bounds.

    Of those that keep them there, it jumps least, then with the least jerk. If none does, it is the
    one that keeps them longest.
    """
    jump_key = jump_column(cases)

    def rank(case: Merge) -> tuple[float, ...]:
        time_ms, at = case.inference_ms or 0.0, case.at
        kept_ms = min(time_ms, at.inference_ms if at else 0.0)
        sizes = (round(getattr(at, jump_key, None) or 0.0, 6), at and at.jerk_rms_rad_s3)
        return (-kept_ms, *(float(f"{size or 0.0:.2g}") for size in sizes), -time_ms)

    return min((case for case in cases if case.inference_ms is not None), key=rank, default=None)


def jump_column(cases: Sequence[Merge]) -> str:
    """Return in which unit jumps are compared: in rad where no jump moves the tip."""
    sizes_mm = [case.at.jump_mm for case in cases if case.at]
    return "jump_mm" if any(sizes_mm) and None not in sizes_mm else "jump_rad"


def longest(cases: Sequence[Merge]) -> Merge:
    """Return the merge that keeps the bounds up to the largest inference time; one has to."""
    return max(cases, key=lambda case: case.inference_ms or 0.0)


def _point(time_ms: float, rows: list[Row]) -> Point:
    columns = {name: _OTHER_COLUMNS.get(name, name) for name in shown_in(Point)}
    largest = {name: worst([row.get(column) for row in rows]) for name, column in columns.items()}
    margins = [row.get("margin_min") for row in rows]
    largest["bound_used"] = worst([None if left is None else 1.0 - left for left in margins])
    return Point(
        inference_ms=time_ms, runs=len(rows), runs_kept=sum(map(held, rows)), ends=_reason(rows),
        worst_point=min(rows, key=tolerated)["point"],
        **{name: None if each is None else round(each, 9) for name, each in largest.items()},
    )  # fmt: skip


def _reason(rows: Sequence[Row]) -> str | None:
    """Return the commonest reason why runs are not tolerated; None for none."""
    reasons = Counter(filter(None, map(reason_of, rows)))
    return reasons.most_common(1)[0][0] if reasons else None


def _largest(by_time: Mapping[float, list[Row]]) -> tuple[float | None, str | None]:
    """Return the inference time up to which all runs are tolerated, and what ends it."""
    largest_ms = None
    for time_ms, rows in by_time.items():
        if not rows or not all(map(tolerated, rows)):
            return largest_ms, _reason(rows)
        largest_ms = time_ms
    return largest_ms, None


def _of_tasks(rows: list[Row], times_ms: Sequence[float]) -> OfTasks | None:
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
    middle = found[(len(found) - 1) // 2]
    return OfTasks(tasks=len(found), smallest=found[0], median=middle, largest=found[-1])

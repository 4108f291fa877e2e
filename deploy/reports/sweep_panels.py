"""The report of a sweep: curves over one swept key, heat maps over two."""

from __future__ import annotations

import itertools
from typing import Any

import plotly.graph_objects as go

from deploy.reports.figures.study import Curve, curves, heat_map
from deploy.reports.page import Panel
from deploy.reports.study_panels import Rerun, StudyPage, Summary, clickable
from deploy.reports.study_text import shown_value
from deploy.reports.tables import number

_MOST_CURVES = 14
_MOST_HEAT_MAPS = 6
_FIELD_CAPTION = "Means over the seeds; the darker, the worse."
_METRICS = {
    "violation_fraction": ("Ticks outside the bounds", "ticks outside (%)", 100.0),
    "worst_rms_rad": ("RMS error of the worst joint", "RMS error (mrad)", 1e3),
}


def sweep_page(summary: Summary, rerun: Rerun) -> StudyPage:
    """What the report of a sweep says."""
    points = summary["points"]
    kept = sum(point["runs_kept"] == point["runs"] for point in points)
    level = "good" if kept == len(points) else "mixed" if kept else "bad"
    axes = [_title(axis) for axis in summary["axes"]]
    return StudyPage(
        kind="sweep",
        level=level,
        headline=f"{kept} of {len(points)} points kept their bounds in every run",
        reasons=[
            f"{_title(axis)}: {', '.join(map(shown_value, axis['values']))}"
            for axis in summary["axes"]
        ],
        tiles=[("Sweep", summary["name"]), ("Scenario", summary["scenario"])],
        sections={
            "Curves": _curve_panels(summary, rerun),
            "Heat maps": _heat_panels(summary, rerun),
        },
        table_title="Points",
        header=["Point", *axes, "Runs that kept their bounds", "Ticks outside (%)",
                "Worst run (%)", "Worst joint's RMS (mrad)", "Failed runs"],
        rows=[_row(point) for point in points],
        table_note="Means over the seeds of a point; the worst run is the one with the most ticks"
        " outside.",
        points=[(_name(summary, point), point["point"]) for point in points],
    )  # fmt: skip


def _curve_panels(summary: Summary, rerun: Rerun) -> list[Panel[Summary]]:
    """Every metric over the numeric key with the most values, a line for each of the others."""
    order = _by_size(summary)
    if not order:
        return []
    x = next((axis for axis in order if _is_numeric(summary["axes"][axis])), order[0])
    others = [axis for axis in range(len(summary["axes"])) if axis != x]
    lines: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    for point in summary["points"]:
        lines.setdefault(tuple(shown_value(point["values"][axis]) for axis in others), []).append(
            point
        )
    drawn = list(lines.items())[:_MOST_CURVES]
    caption = "Lines are means over the seeds, the shades reach from the best run to the worst."
    if len(lines) > len(drawn):
        caption += f" {len(drawn)} of {len(lines)} lines are drawn; all points are in the table."
    panels = []
    for metric, (title, y_title, factor) in _METRICS.items():
        traces = [
            Curve(", ".join(chosen) or "all runs", index % 7, index // 7,
                  [point["values"][x] for point in points], [point[metric] for point in points],
                  [rerun(point["point"]) for point in points])
            for index, (chosen, points) in enumerate(drawn)
        ]  # fmt: skip
        log = metric == "worst_rms_rad"
        figure = curves(traces, _title(summary["axes"][x]), y_title, factor, log=log)
        panels.append(clickable(f"curve-{metric}", title, caption, figure))
    return panels


def _heat_panels(summary: Summary, rerun: Rerun) -> list[Panel[Summary]]:
    """Every metric over the two keys with the most values, a field for each of the others."""
    order = _by_size(summary)[:2]
    if len(order) < 2:
        return []
    others = [axis for axis in range(len(summary["axes"])) if axis not in order]
    combinations = itertools.product(*(summary["axes"][axis]["values"] for axis in others))
    panels = []
    for index, chosen in enumerate(itertools.islice(combinations, _MOST_HEAT_MAPS)):
        points = [
            point
            for point in summary["points"]
            if all(
                point["values"][axis] == value for axis, value in zip(others, chosen, strict=True)
            )
        ]
        for metric, (title, _, _) in _METRICS.items():
            name = " · ".join([title, *map(shown_value, chosen)])
            figure = _field(summary, points, order, metric, rerun)
            panels.append(clickable(f"field-{metric}-{index}", name, _FIELD_CAPTION, figure))
    return panels


def _field(
    summary: Summary, points: list[Summary], order: list[int], metric: str, rerun: Rerun
) -> go.Figure:
    """One metric over two keys, at given values of all others."""
    _, unit, factor = _METRICS[metric]
    by_place = {tuple(point["values"][axis] for axis in order): point for point in points}
    x, y = (summary["axes"][axis] for axis in order)
    rows = [[by_place.get((a, b)) for a in x["values"]] for b in y["values"]]
    means = [[point[metric]["mean"] if point else None for point in row] for row in rows]
    return heat_map(
        (_title(x), x["values"]),
        (_title(y), y["values"]),
        [[None if mean is None else factor * mean for mean in row] for row in means],
        [[rerun(point["point"]) if point else "" for point in row] for row in rows],
        unit,
    )


def _row(point: Summary) -> list[str]:
    outside, rms = point["violation_fraction"], point["worst_rms_rad"]
    kept = f"{point['runs_kept']} of {point['runs']}"
    return [
        point["point"], *map(shown_value, point["values"]), kept,
        number(outside["mean"], 100.0), number(outside["highest"], 100.0),
        number(rms["mean"], 1e3), str(point["runs_failed"]),
    ]  # fmt: skip


def _name(summary: Summary, point: Summary) -> str:
    given = zip(map(_title, summary["axes"]), point["values"], strict=True)
    return ", ".join(f"{keys} = {shown_value(value)}" for keys, value in given) or "all"


def _title(axis: Summary) -> str:
    return ", ".join(axis["keys"])


def _by_size(summary: Summary) -> list[int]:
    """Axes with more than one value, the longest first."""
    sizes = {index: len(axis["values"]) for index, axis in enumerate(summary["axes"])}
    return sorted((axis for axis in sizes if sizes[axis] > 1), key=lambda axis: -sizes[axis])


def _is_numeric(axis: Summary) -> bool:
    return all(isinstance(value, float) for value in axis["values"])

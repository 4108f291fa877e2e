"""The report of a sweep: curves over one swept key, heat maps over two."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from functools import partial
from typing import Any

import plotly.graph_objects as go

from deploy.reports.figures.studies import many_runs
from deploy.reports.page import Fact, Panel
from deploy.reports.studies.study_content import Study, StudyContent, Summary
from deploy.reports.studies.study_tables import point_table, shown_value
from deploy.reports.verdict import ReportHead

_MOST_CURVES = 14
_MOST_HEAT_MAPS = 6
QUANTITIES = [many_runs.TICKS_OUTSIDE, many_runs.WORST_RMS]
"""What is drawn of every sweep; another one is another entry."""


def sweep_content(summary: Summary) -> StudyContent:
    """What the report of a sweep says."""
    points = summary["points"]
    kept = sum(point["runs_kept"] == point["runs"] for point in points)
    return StudyContent(
        kind="sweep",
        verdict=ReportHead(
            "good" if kept == len(points) else "mixed" if kept else "bad",
            f"{kept} of {len(points)} points kept their bounds in every run",
            [
                f"{_title(axis)}: {', '.join(map(shown_value, axis['values']))}"
                for axis in summary["axes"]
            ],
        ),
        facts=[
            Fact("Sweep", summary["name"]),
            Fact("Scenario", summary["scenario"]),
            *([Fact("Plants", f"{summary['plants']}")] if summary["plants"] else []),
        ],
        panels=[*_curve_panels(summary), *_heat_map_panels(summary)],
        results=[point_table(summary)],
        points=[(_name(summary, point), point["worst_point"]) for point in points],
    )


def _curve_panels(summary: Summary) -> list[Panel[Study]]:
    """Every quantity over the numeric key with the most values, a line for each of the others."""
    order = _by_size(summary)
    if not order:
        return []
    x = next((axis for axis in order if _is_numeric(summary["axes"][axis])), order[0])
    lines: dict[str, list[Summary]] = {}
    for point in summary["points"]:
        others = [axis for axis in order if axis != x]
        lines.setdefault(_given(summary, point, others) or "all runs", []).append(point)
    caption = "Lines are means over all runs, the shades reach from the best run to the worst."
    if summary["plants"]:
        caption = caption[:-1] + "; for plants kept, shares with Wilson's 95 % intervals."
    if len(lines) > _MOST_CURVES:
        caption += f" {_MOST_CURVES} of {len(lines)} lines are drawn; all points are in the table."
    drawn = dict(itertools.islice(lines.items(), _MOST_CURVES))

    def draw(study: Study, quantity: many_runs.StudyQuantity) -> go.Figure | None:
        shown = [
            many_runs.Curve(
                name, index % 7, index // 7, [_point(study, p, p["values"][x]) for p in points]
            )
            for index, (name, points) in enumerate(drawn.items())
        ]
        return many_runs.curves(shown, _title(summary["axes"][x]), quantity)

    return [
        Panel("Curves", f"curve-{quantity.key}", quantity.title,
              partial(draw, quantity=quantity), caption, is_clickable=True)
        for quantity in _quantities(summary)
    ]  # fmt: skip


def _heat_map_panels(summary: Summary) -> list[Panel[Study]]:
    """Every quantity over the two keys with the most values, a map for each of the others."""
    order = _by_size(summary)[:2]
    if len(order) < 2:
        return []
    others = [axis for axis in range(len(summary["axes"])) if axis not in order]
    combinations = itertools.product(*(summary["axes"][axis]["values"] for axis in others))
    x, y = (summary["axes"][axis] for axis in order)

    def draw(
        study: Study, chosen: tuple[Any, ...], quantity: many_runs.StudyQuantity
    ) -> go.Figure | None:
        places = {
            tuple(point["values"][axis] for axis in order): _point(study, point)
            for point in summary["points"]
            if chosen == tuple(point["values"][axis] for axis in others)
        }
        rows = [[places.get((a, b)) for a in x["values"]] for b in y["values"]]
        return many_runs.heat_map(
            (_title(x), x["values"]), (_title(y), y["values"]), rows, quantity
        )

    return [
        Panel("Heat maps", f"field-{quantity.key}-{index}",
              " · ".join([quantity.title, *_named(summary, others, chosen)]),
              partial(draw, chosen=chosen, quantity=quantity),
              _heat_caption(quantity), is_clickable=True)
        for index, chosen in enumerate(itertools.islice(combinations, _MOST_HEAT_MAPS))
        for quantity in _quantities(summary)
    ]  # fmt: skip


def _heat_caption(quantity: many_runs.StudyQuantity) -> str:
    return (
        f"Means over all runs; the darker, the {'worse' if quantity.more_is_worse else 'better'}."
    )


def _point(study: Study, point: Summary, x: Any = None) -> many_runs.Point:
    shares = many_runs.share_spread(point) if "wilson_95" in point else {}
    return many_runs.Point(x, {**point, **shares}, study.rerun(point["worst_point"]))


def _quantities(summary: Summary) -> list[many_runs.StudyQuantity]:
    """What is drawn, each as curves and as heat maps."""
    return [*([many_runs.PLANTS_KEPT] if summary["plants"] else []), *QUANTITIES]


def _name(summary: Summary, point: Summary) -> str:
    return _given(summary, point, range(len(summary["axes"]))) or "all"


def _given(summary: Summary, point: Summary, axes: Iterable[int]) -> str:
    """What a point has on some axes, each value with its keys."""
    places = list(axes)
    return ", ".join(_named(summary, places, [point["values"][axis] for axis in places]))


def _named(summary: Summary, axes: Iterable[int], values: Iterable[Any]) -> list[str]:
    titles = (_title(summary["axes"][axis]) for axis in axes)
    return [f"{keys} = {shown_value(value)}" for keys, value in zip(titles, values, strict=True)]


def _title(axis: Summary) -> str:
    return ", ".join(axis["keys"])


def _by_size(summary: Summary) -> list[int]:
    """Axes with more than one value, the longest first."""
    sizes = {index: len(axis["values"]) for index, axis in enumerate(summary["axes"])}
    return sorted((axis for axis in sizes if sizes[axis] > 1), key=lambda axis: -sizes[axis])


def _is_numeric(axis: Summary) -> bool:
    return all(isinstance(value, float) for value in axis["values"])

"""The report of a sweep: curves over one swept key, heat maps over two."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from functools import partial
from typing import Any

import plotly.graph_objects as go

from deploy.reports.figures import study_figures
from deploy.reports.figures.study_figures import DrawnStudy
from deploy.reports.page import Cards, Fact, Page, Panel
from deploy.reports.study_tables import point_table, shown_value
from deploy.reports.verdict import ReportHead

Summary = dict[str, Any]

_MOST_CURVES = 14
_MOST_HEAT_MAPS = 6
QUANTITIES = [study_figures.TICKS_OUTSIDE, study_figures.WORST_RMS]
"""What is drawn of every sweep; another one is another entry."""


def sweep_page(study: DrawnStudy) -> Page[DrawnStudy]:
    """The report of a sweep."""
    summary = study.summary
    points = summary["points"]
    every = range(len(summary["axes"]))
    kept = sum(point["runs_kept"] == point["runs"] for point in points)
    return Page(
        "sweep",
        summary["name"],
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
        subject=study,
        after=("Results", [Cards([point_table(summary)], "stacked")]),
        points=[
            (
                _given(summary, point, every) or "all",
                point["worst_point"],
                study.rerun(point["worst_point"]),
            )
            for point in points
        ],
    )


def _curve_panels(summary: Summary) -> list[Panel[DrawnStudy]]:
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

    def draw(study: DrawnStudy, quantity: study_figures.StudyQuantity) -> go.Figure | None:
        shown = [
            study_figures.Curve(
                name, index % 7, index // 7, [_point(study, p, p["values"][x]) for p in points]
            )
            for index, (name, points) in enumerate(drawn.items())
        ]
        return study_figures.curves(shown, _title(summary["axes"][x]), quantity)

    return [
        Panel("Curves", f"curve-{quantity.key}", quantity.title,
              partial(draw, quantity=quantity), caption, is_clickable=True)
        for quantity in _quantities(summary)
    ]  # fmt: skip


def _heat_map_panels(summary: Summary) -> list[Panel[DrawnStudy]]:
    """Every quantity over the two keys with the most values, a map for each of the others."""
    order = _by_size(summary)[:2]
    if len(order) < 2:
        return []
    others = [axis for axis in range(len(summary["axes"])) if axis not in order]
    combinations = itertools.product(*(summary["axes"][axis]["values"] for axis in others))
    x, y = (summary["axes"][axis] for axis in order)

    def draw(
        study: DrawnStudy, chosen: tuple[Any, ...], quantity: study_figures.StudyQuantity
    ) -> go.Figure | None:
        places = {
            tuple(point["values"][axis] for axis in order): _point(study, point)
            for point in summary["points"]
            if chosen == tuple(point["values"][axis] for axis in others)
        }
        rows = [[places.get((a, b)) for a in x["values"]] for b in y["values"]]
        return study_figures.heat_map(
            (_title(x), x["values"]), (_title(y), y["values"]), rows, quantity
        )

    return [
        Panel("Heat maps", f"field-{quantity.key}-{index}",
              " · ".join([quantity.title, *_named(summary, others, chosen)]),
              partial(draw, chosen=chosen, quantity=quantity),
              "Means over all runs; the darker, the "
              f"{'worse' if quantity.more_is_worse else 'better'}.", is_clickable=True)
        for index, chosen in enumerate(itertools.islice(combinations, _MOST_HEAT_MAPS))
        for quantity in _quantities(summary)
    ]  # fmt: skip


def _point(study: DrawnStudy, point: Summary, x: Any = None) -> study_figures.Point:
    shares = study_figures.share_spread(point) if "wilson_95" in point else {}
    return study_figures.Point(x, {**point, **shares}, study.rerun(point["worst_point"]))


def _quantities(summary: Summary) -> list[study_figures.StudyQuantity]:
    """What is drawn, each as curves and as heat maps."""
    return [*([study_figures.PLANTS_KEPT] if summary["plants"] else []), *QUANTITIES]


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

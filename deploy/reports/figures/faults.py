"""Shades in figures over time: when a scheduled fault was active."""

from __future__ import annotations

from collections.abc import Callable

import plotly.graph_objects as go

from bus_schema.messages import topics
from deploy.reports.figures import style
from deploy.runs.run_data import RunData

_OPACITY = 0.09
_LEAST_SHARE = 0.002

Draw = Callable[[RunData], go.Figure | None]


def with_faults(draw: Draw) -> Draw:
    """The figure over time that `draw` makes, with its scheduled faults as shades behind it."""

    def shaded(run: RunData) -> go.Figure | None:
        figure = draw(run)
        if figure is not None:
            _shade(figure, run)
        return figure

    return shaded


def fault_spans_s(run: RunData) -> list[tuple[float, float]]:
    """Begin and end of every fault within the run; one of an instant is wide enough to be seen."""
    times_s = run.times_s(topics.PLANT_TRUTH)
    if not len(times_s):
        return []
    end_s = float(times_s[-1])
    spans = []
    for fault in run.setup.scenario.faults:
        if fault.at_s <= end_s:
            until_s = min(fault.end_ns * 1e-9, end_s)
            spans.append((fault.at_s, max(until_s, fault.at_s + _LEAST_SHARE * end_s)))
    return spans


def _shade(figure: go.Figure, run: RunData) -> None:
    """Add the shades: one shape in each row, as Plotly takes its time for each of hundreds."""
    spans = fault_spans_s(run)
    if not spans:
        return
    outline = " ".join(f"M{start},0 L{start},1 L{end},1 L{end},0 Z" for start, end in spans)
    look = {
        "type": "path", "path": outline, "fillcolor": style.ALARM, "opacity": _OPACITY,
        "line": {"width": 0}, "layer": "below",
    }  # fmt: skip
    axes = dict.fromkeys((trace.xaxis or "x", trace.yaxis or "y") for trace in figure.data)
    shades = [{**look, "xref": x, "yref": f"{y} domain"} for x, y in axes]
    figure.layout.shapes = [*figure.layout.shapes, *shades]

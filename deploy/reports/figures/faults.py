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
    has_rows = len(list(figure.select_yaxes())) > 1
    where = {"row": "all", "col": "all"} if has_rows else {}
    for start_s, end_s in fault_spans_s(run):
        figure.add_vrect(
            start_s,
            end_s,
            fillcolor=style.ALARM,
            opacity=_OPACITY,
            line_width=0,
            layer="below",
            **where,
        )

"""Figures of how well time was kept.

Every function gives None where a run has nothing to draw.
"""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from bus_schema.arrays import Vector
from bus_schema.messages import topics
from deploy.reports.figures import style
from deploy.reports.quantities import TIMES
from deploy.runs.judging.metrics import times_us
from deploy.runs.run_data import RunData

_PERCENTILES = (50.0, 90.0, 99.0, 99.9, 99.99, 99.999, 99.9999)
_CURVE_POINTS = 300
_BARS = 200


def timing_percentiles(run: RunData) -> go.Figure | None:
    """Every timing quantity as a curve over its percentiles, spaced by 1 / (1 − p)."""
    quantities = {TIMES[key]: values for key, values in times_us(run).items() if len(values)}
    longest = max((len(values) for values in quantities.values()), default=0)
    if not longest:
        return None
    figure = go.Figure()
    for index, (name, values) in enumerate(quantities.items()):
        figure.add_trace(percentile_curve(name, values, style.palette(index)))
    style.apply(figure, 460, legend=True)
    percentile_axes(figure, longest)
    return figure


def percentile_axes(figure: go.Figure, values: int) -> None:
    """Give a figure of times the axes of `percentile_curve`; its longest has so many values."""
    ticks = [p for p in _PERCENTILES if 1.0 / (1.0 - p / 100.0) <= 1.5 * values]
    figure.update_xaxes(
        type="log",
        title_text="percentile",
        tickvals=[1.0 / (1.0 - p / 100.0) for p in ticks],
        ticktext=[f"{p:.6g} %" for p in ticks],
    )
    figure.update_yaxes(type="log", title_text="µs", dtick=1, tickformat=",")


def deadline_misses(run: RunData) -> go.Figure | None:
    """Ticks that missed their deadline, over time; None if none did."""
    truth = run.tables[topics.PLANT_TRUTH.name]
    times_s = run.times_s(topics.PLANT_TRUTH)
    missed = truth["deadline_met"] == 0
    if not missed.any():
        return None
    edges = np.linspace(0.0, times_s[-1] + run.setup.grid.period_ns * 1e-9, _BARS + 1)
    misses, _ = np.histogram(times_s[missed], edges)
    ticks, _ = np.histogram(times_s, edges)
    percent = 100.0 * misses / np.maximum(ticks, 1)
    figure = go.Figure(
        go.Bar(
            x=(edges[:-1] + edges[1:]) / 2, y=percent, customdata=misses,
            marker={"color": style.ALARM, "line": {"width": 0}},
            hovertemplate="%{x:.3g} s: %{customdata} ticks, %{y:.1f} %<extra></extra>",
        )
    )  # fmt: skip
    style.apply(figure, 460)
    figure.update_layout(bargap=0)
    figure.update_xaxes(title_text="time (s)", range=[0.0, edges[-1]])
    figure.update_yaxes(title_text="missed ticks (%)", rangemode="tozero")
    return figure


def percentile_curve(name: str, values: Vector, colour: str) -> go.Scatter:
    """A time as a curve over its percentiles, spaced by 1 / (1 − p)."""
    one_in = np.geomspace(1.0, max(len(values), 2), _CURVE_POINTS)
    percentiles = 1.0 - 1.0 / one_in
    curve = np.quantile(values, percentiles, method="inverted_cdf")
    return go.Scatter(
        x=one_in, y=np.where(curve > 0.0, curve, np.nan), mode="lines",
        name=style.plain(name if curve[-1] > 0.0 else f"{name} (always 0)"),
        line={"color": colour, "width": 2, "shape": "hv"},
        customdata=100.0 * percentiles, hovertemplate="%{customdata:.5g} %: %{y:.4g} µs",
    )  # fmt: skip

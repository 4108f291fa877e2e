"""Figures of how well several laws track, side by side: errors, and the path of the end effector.

Every function gives None where a comparison has nothing to draw.
"""

from __future__ import annotations

import html
from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from bus_schema.arrays import Matrix, Vector
from bus_schema.messages import topics
from deploy.comparison.comparison import Comparison
from deploy.reports.figures import run as figures
from deploy.reports.figures.style import (
    INK,
    MUTED,
    band,
    joint_colour,
    joint_rows,
    line,
    style,
)

_MRAD = _MM = 1e3
_ZOOM_S = 1.0
_BAND_POINTS = 400
_ENVELOPE_S = 0.05
_SMALLEST = 1e-6
_BUTTONS_PX = 28  # plotly's, which stand above the legend
_LEGEND_PX = 62  # three rows, which six laws take


def rms_bars(comparison: Comparison) -> go.Figure | None:
    """RMS error of every joint under every law, on a logarithmic scale."""
    return joint_bars(comparison, "tracking", "rms_rad", "RMS error (mrad)", _MRAD)


def joint_bars(
    comparison: Comparison, section: str, key: str, unit: str, factor: float = 1.0
) -> go.Figure | None:
    """One number of the summaries for every joint and law, as bars on a logarithmic scale."""
    figure = go.Figure()
    for run in comparison.runs:
        values, names = run.summary[section][key], run.summary["tracking"]["joint_names"]
        if values is None:
            continue
        heights = [None if not value else factor * value for value in values]
        colour = joint_colour(comparison.colour_index(run.law))
        bars = go.Bar(
            x=[html.escape(name) for name in names], y=heights, name=html.escape(run.law),
            marker={"color": colour, "line": {"width": 0}}, hovertemplate="%{y:.3g}",
        )  # fmt: skip
        figure.add_trace(bars)
    if not any(height for bars in figure.data for height in bars.y):
        return None
    style(figure, 420)
    put_legend_on_top(figure)
    figure.update_layout(barmode="group", bargap=0.25, bargroupgap=0.08)
    figure.update_yaxes(type="log", title_text=unit, dtick=1, tickformat="~g")
    return figure


def errors_in_funnel(comparison: Comparison) -> go.Figure | None:
    """True errors of every joint inside their bounds, scaled to the bounds' steady state."""
    figure = _errors(comparison, np.inf)
    if figure is not None:
        final = _MRAD * comparison.drawn[0].data.setup.funnel.final_rad
        for joint, limit in enumerate(1.6 * final):
            figure.update_yaxes(range=[-limit, limit], row=joint + 1)
    return figure


def errors_first_second(comparison: Comparison) -> go.Figure | None:
    """True errors of every joint inside their bounds, at the start of the runs."""
    return _errors(comparison, _ZOOM_S)


def error_envelopes(comparison: Comparison) -> go.Figure | None:
    """Size of the true error of every joint on a logarithmic scale, with its steady bound."""
    if not comparison.drawn:
        return None
    setup = comparison.drawn[0].data.setup
    figure = law_rows(setup.robot.joint_names, "mrad")
    for run in comparison.drawn:
        times_s = run.data.times_s(topics.PLANT_TRUTH)
        _add_envelopes(figure, comparison, run.law, times_s, _MRAD * run.data.true_errors_rad)
    for joint, final in enumerate(_MRAD * setup.funnel.final_rad):
        dotted = {"color": MUTED, "width": 1, "dash": "dot"}
        figure.add_hline(float(final), row=joint + 1, line=dotted)
    return figure


def tip_paths(comparison: Comparison) -> go.Figure | None:
    """Path of the tip under every law, and the path asked for."""
    figure = go.Figure()
    for run in comparison.drawn:
        _, actual, wanted = figures.tip_positions(run.data)
        if not figure.data:
            stroke = {"color": "#c3cad1", "width": 12}
            figure.add_trace(figures.path_line(wanted, "reference", stroke))
            figure.add_trace(figures.path_point(actual[0], "start", "circle"))
        colour = joint_colour(comparison.colour_index(run.law))
        stroke = {"color": colour, "width": 4}
        figure.add_trace(figures.path_line(actual, html.escape(run.law), stroke))
    if not figure.data:
        return None
    figures.style_path(figure, 560)
    return figure


def tip_error_envelopes(comparison: Comparison) -> go.Figure | None:
    """Size of the tip's error along each axis of the base frame, on a logarithmic scale."""
    if not comparison.drawn:
        return None
    figure = law_rows(("x", "y", "z"), "mm")
    for run in comparison.drawn:
        times_s, actual, wanted = figures.tip_positions(run.data)
        _add_envelopes(figure, comparison, run.law, times_s, _MM * (actual - wanted))
    return figure


def network_output(comparison: Comparison) -> go.Figure | None:
    """What the first law with a network learned, against the dynamics it stands in for."""
    drawings = (figures.network_output(run.data) for run in comparison.drawn)
    return next((figure for figure in drawings if figure is not None), None)


def law_rows(names: Sequence[str], unit: str) -> go.Figure:
    """A figure with one row per joint or axis, to hold a line per law in each."""
    figure = joint_rows(tuple(names), unit)
    figure.update_annotations(font={"size": 12, "color": INK})
    put_legend_on_top(figure)
    return figure


def add_law(
    figure: go.Figure, comparison: Comparison, law: str, row: int, x: Vector, y: Vector
) -> None:
    """Add a law's line to a row of `law_rows`; its first one stands in the legend."""
    trace = line(x, y, joint_colour(comparison.colour_index(law)), html.escape(law), 1.3)
    figure.add_trace(
        trace.update(
            legendgroup=law_group(comparison, law),
            legendrank=comparison.colour_index(law) + 1,
            showlegend=row == 1,
        ),
        row=row,
        col=1,
    )


def law_group(comparison: Comparison, law: str) -> str:
    """Group of a law's traces in a legend: what is switched off there disappears everywhere."""
    return f"law{comparison.colour_index(law)}"


def _errors(comparison: Comparison, until_s: float) -> go.Figure | None:
    if not comparison.drawn:
        return None
    setup = comparison.drawn[0].data.setup
    end_s = max(run.data.times_s(topics.PLANT_TRUTH)[-1] for run in comparison.drawn)
    band_s = np.linspace(0.0, min(until_s, end_s), _BAND_POINTS)
    upper, lower = (_MRAD * bound for bound in setup.funnel.bounds(band_s))
    figure = law_rows(setup.robot.joint_names, "mrad")
    for joint in range(setup.robot.joints):
        traces = band(band_s, upper[:, joint], lower[:, joint])
        for trace in traces:
            trace.update(showlegend=False, hoverinfo="skip")
        figure.add_traces(traces, rows=joint + 1, cols=1)
    for run in reversed(comparison.drawn):  # the first law lies on top
        times_s = run.data.times_s(topics.PLANT_TRUTH)
        shown = times_s <= until_s
        errors = _MRAD * run.data.true_errors_rad[shown]
        for joint in range(setup.robot.joints):
            add_law(figure, comparison, run.law, joint + 1, times_s[shown], errors[:, joint])
    figure.update_xaxes(range=[0.0, band_s[-1]])
    return figure


def _add_envelopes(
    figure: go.Figure, comparison: Comparison, law: str, times_s: Vector, errors: Matrix
) -> None:
    """Add the largest |error| of each short stretch of time, one row per column of `errors`."""
    step_s = float(times_s[1] - times_s[0])
    starts = np.arange(0, len(times_s), max(1, round(_ENVELOPE_S / step_s)))
    largest = np.maximum.reduceat(np.abs(errors), starts, axis=0)
    for index, values in enumerate(largest.T):
        shown = np.where(values > _SMALLEST, values, np.nan)
        add_law(figure, comparison, law, index + 1, times_s[starts], shown)
    figure.update_yaxes(type="log", dtick=1, tickformat="~g")


def put_legend_on_top(figure: go.Figure) -> None:
    """Make room above a figure for a legend of laws, below the buttons in the corner."""
    height = figure.layout.height + _BUTTONS_PX + _LEGEND_PX
    figure.update_layout(
        height=height,
        margin={"t": figure.layout.margin.t + _BUTTONS_PX + _LEGEND_PX},
        showlegend=True,
        legend={
            "x": 0, "xanchor": "left", "y": 1 - _BUTTONS_PX / height, "yanchor": "top",
            "yref": "container", "traceorder": "normal", "entrywidthmode": "fraction",
            "entrywidth": 0.48,
        },
    )  # fmt: skip

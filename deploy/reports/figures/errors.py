"""Figures of errors inside their bounds, of one run or of several laws side by side.

Every function gives None where there is nothing to draw.
"""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from bus_schema.arrays import Vector
from bus_schema.messages import topics
from deploy.comparison.comparison import Comparison
from deploy.reports.figures import style
from deploy.reports.figures.laws import add_envelopes, add_law, with_law_legend
from deploy.runs.judging.bounds import bound_usage
from deploy.runs.run_data import RunData
from deploy.scenario.setup import Setup

_ZOOM_S = 1.0
_BAND_POINTS = 600
_HEADROOM = 1.6


def error_in_funnel(run: RunData) -> go.Figure | None:
    """True error of every joint inside its bounds, scaled to the bounds' steady state."""
    figure = _errors(run, np.inf)
    late = run.times_s(topics.PLANT_TRUTH) >= run.setup.scenario.metrics.from_s
    if figure is not None and late.any():
        largest = np.abs(run.true_errors_rad[late]).max(axis=0)
        _zoom(figure, np.maximum(_HEADROOM * run.setup.funnel.final_rad, 1.1 * largest))
    return figure


def error_first_second(run: RunData) -> go.Figure | None:
    """True error of every joint inside its bounds, at the start of the run."""
    return _errors(run, _ZOOM_S)


def transformed_error(run: RunData) -> go.Figure | None:
    """Transformed error ε of every joint."""
    return style.joint_series(run, topics.CONTROL_STATUS, "transformed_error", "ε")


def errors_in_funnel(comparison: Comparison) -> go.Figure | None:
    """True errors under every law inside their bounds, scaled to the bounds' steady state."""
    figure = _errors_by_law(comparison, np.inf)
    if figure is not None:
        _zoom(figure, _HEADROOM * comparison.drawn[0].data.setup.funnel.final_rad)
    return figure


def errors_first_second(comparison: Comparison) -> go.Figure | None:
    """True errors under every law inside their bounds, at the start of the runs."""
    return _errors_by_law(comparison, _ZOOM_S)


def error_envelopes(comparison: Comparison) -> go.Figure | None:
    """Size of the true error of every joint on a logarithmic scale, with its steady bound."""
    if not comparison.drawn:
        return None
    setup = comparison.drawn[0].data.setup
    figure = with_law_legend(style.joint_rows(setup.robot.joint_names, "mrad"))
    for run in comparison.drawn:
        times_s = run.data.times_s(topics.PLANT_TRUTH)
        add_envelopes(figure, comparison, run.law, times_s, style.MRAD * run.data.true_errors_rad)
    for joint, final in enumerate(style.MRAD * setup.funnel.final_rad):
        figure.add_hline(float(final), row=joint + 1, line=style.DOTTED)
    return figure


def _errors(run: RunData, until_s: float) -> go.Figure | None:
    times_s = run.times_s(topics.PLANT_TRUTH)
    shown = times_s <= until_s
    if not shown.any():
        return None
    times_s, errors = times_s[shown], style.MRAD * run.true_errors_rad[shown]
    outside = bound_usage(run)[shown] >= 1.0
    figure = _bounds(run.setup, times_s[0], times_s[-1])
    for joint, (error, out) in enumerate(zip(errors.T, outside.T, strict=True)):
        traces = [style.line(times_s, error, style.palette(joint), "true error")]
        if out.any():
            marks = style.line(times_s[out], error[out], style.ALARM, "outside the bounds")
            traces.append(marks.update(mode="markers", marker={"size": 3, "color": style.ALARM}))
        figure.add_traces(traces, rows=joint + 1, cols=1)
    return figure


def _errors_by_law(comparison: Comparison, until_s: float) -> go.Figure | None:
    if not comparison.drawn:
        return None
    end_s = max(run.data.times_s(topics.PLANT_TRUTH)[-1] for run in comparison.drawn)
    figure = _bounds(comparison.drawn[0].data.setup, 0.0, min(until_s, end_s))
    figure.update_traces(showlegend=False, hoverinfo="skip")
    with_law_legend(figure)
    for run in reversed(comparison.drawn):  # the first law lies on top
        times_s = run.data.times_s(topics.PLANT_TRUTH)
        shown = times_s <= until_s
        errors = style.MRAD * run.data.true_errors_rad[shown]
        add_law(figure, comparison, run.law, times_s[shown], errors.T)
    return figure


def _bounds(setup: Setup, from_s: float, until_s: float) -> go.Figure:
    """A row per joint, with its bounds as a shaded band."""
    times_s = np.linspace(from_s, until_s, _BAND_POINTS)
    figure = style.joint_rows(setup.robot.joint_names, "mrad")
    upper, lower = (style.MRAD * bound.T for bound in setup.funnel.bounds(times_s))
    for joint in range(setup.robot.joints):
        figure.add_traces(style.band(times_s, upper[joint], lower[joint]), rows=joint + 1, cols=1)
    figure.update_xaxes(range=[from_s, until_s])
    return figure


def _zoom(figure: go.Figure, limits_rad: Vector) -> None:
    for row, limit in enumerate(style.MRAD * limits_rad, start=1):
        figure.update_yaxes(range=[-limit, limit], row=row)

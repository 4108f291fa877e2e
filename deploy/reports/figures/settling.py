"""Figures of how soon several laws settle, against the bounds of those that have one.

Every function gives None where a comparison has nothing to draw.
"""

from __future__ import annotations

import plotly.graph_objects as go

from deploy.comparison.comparison import Comparison
from deploy.comparison.settling import LONGEST_S, SettlingTest
from deploy.reports.figures.laws import add_law_legend, joint_bars, law_colour, law_group
from deploy.reports.figures.style import plain, style
from deploy.reports.quantities import SETTLING_BOUND, SETTLING_TIME


def settling(comparison: Comparison) -> go.Figure | None:
    """Settling time of every joint under every law, with the bound of those that have one."""
    figure = joint_bars(comparison, SETTLING_TIME)
    if figure is None:
        return None
    figure.update_yaxes(type="linear", dtick=None)
    for run in comparison.runs:
        bounds = SETTLING_BOUND.of_joints(run.summary)
        if any(bound is not None for bound in bounds):
            colour = law_colour(comparison, run.law)
            figure.add_scatter(
                x=[plain(name) for name in run.summary["tracking"]["joint_names"]], y=bounds,
                name=f"bound of {plain(run.law)}", mode="lines+markers", showlegend=False,
                line={"color": colour, "width": 1.5, "dash": "dash"},
                marker={"symbol": "line-ew-open", "size": 18, "color": colour},
            )  # fmt: skip
    return figure


def settling_from_afar(comparison: Comparison) -> go.Figure | None:
    """Settling time over the size of the initial error, and one bound for all of them."""
    if not comparison.settling:
        return None
    figure = go.Figure()
    top_s = min(LONGEST_S, comparison.runs[0].data.setup.scenario.duration_s)
    for test in reversed(comparison.settling):  # the first law lies on top
        look = law_colour(comparison, test.law), law_group(comparison, test.law)
        figure.add_trace(_starts(test, top_s, *look))
        if test.bound_s is not None:
            figure.add_trace(_bound(test, *look))
    style(figure, 460)
    add_law_legend(figure)
    figure.update_layout(legend={"traceorder": "reversed"})
    distances = [row.distance_rad for row in comparison.settling[0].rows]
    figure.update_xaxes(
        type="log", title_text="initial error of every joint (rad)", tickvals=distances
    )
    figure.update_yaxes(title_text="settling time (s)", rangemode="tozero")
    return figure


def _starts(test: SettlingTest, top_s: float, colour: str, group: str) -> go.Scatter:
    """A law's settling times; a cross at the top for a start from which it did not settle."""
    settled = [row.settling_time_s is not None for row in test.rows]
    inside = [row.bounds_kept for row in test.rows]
    symbols = [
        ("circle" if kept else "circle-open") if done else "x-thin-open"
        for done, kept in zip(settled, inside, strict=True)
    ]
    return go.Scatter(
        x=[row.distance_rad for row in test.rows],
        y=[top_s if row.settling_time_s is None else row.settling_time_s for row in test.rows],
        name=plain(test.law), legendgroup=group, mode="lines+markers",
        line={"color": colour, "width": 1.6},
        marker={"symbol": symbols, "size": 9, "color": colour,
                "line": {"color": colour, "width": 2}},
        text=["" if done else " (not settled)" for done in settled],
        hovertemplate="%{x:.3g} rad: %{y:.3g} s%{text}",
    )  # fmt: skip


def _bound(test: SettlingTest, colour: str, group: str) -> go.Scatter:
    """The bound of a law, the same for every start."""
    return go.Scatter(
        x=[row.distance_rad for row in test.rows], y=[test.bound_s] * len(test.rows),
        name=f"bound of {plain(test.law)}", legendgroup=group, showlegend=False,
        mode="lines", line={"color": colour, "width": 1.6, "dash": "dash"},
        hovertemplate="bound %{y:.3g} s",
    )  # fmt: skip

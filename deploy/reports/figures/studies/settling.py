"""Figures of how soon several laws settle, against the bounds of those that have one.

Every function gives None where a comparison has nothing to draw.
"""

from __future__ import annotations

import plotly.graph_objects as go

from deploy.comparison.comparison import Comparison
from deploy.comparison.settling import LONGEST_S, Start
from deploy.reports.figures import style
from deploy.reports.figures.laws import add_law_legend, joint_bars, law_colour, law_group
from deploy.reports.quantities import SETTLING_BOUND, SETTLING_TIME


def settling(comparison: Comparison) -> go.Figure | None:
    """Settling time of every joint under every law, with the bound of those that have one."""
    figure = joint_bars(comparison, SETTLING_TIME)
    if figure is None:
        return None
    figure.update_yaxes(type="linear")
    for run in comparison.runs:
        bounds = SETTLING_BOUND.of_joints(run.summary)
        if any(bound is not None for bound in bounds):
            colour = law_colour(comparison, run.law)
            figure.add_scatter(
                x=[style.plain(name) for name in run.summary["tracking"]["joint_names"]], y=bounds,
                name=f"bound of {style.plain(run.law)}", mode="markers", showlegend=False,
                marker={"symbol": "line-ew-open", "size": 40, "color": colour, "line_width": 2},
            )  # fmt: skip
    return figure


def settling_from_afar(comparison: Comparison) -> go.Figure | None:
    """Settling time over the size of the initial error, and one bound for all of them."""
    if not comparison.settling:
        return None
    figure = go.Figure()
    top_s = min(LONGEST_S, comparison.runs[0].data.setup.scenario.duration_s)
    for test in reversed(comparison.settling):  # the first law lies on top
        colour, group = law_colour(comparison, test.law), law_group(comparison, test.law)
        distances = [start.distance_rad for start in test.starts]
        times = [start.settling_time_s for start in test.starts]
        figure.add_scatter(
            x=distances, y=[top_s if time is None else time for time in times],
            name=style.plain(test.law), legendgroup=group, mode="lines+markers",
            line={"color": colour, "width": 1.6},
            marker={"symbol": [_symbol(start) for start in test.starts], "size": 9, "color": colour,
                    "line": {"color": colour, "width": 2}},
            text=[" (not settled)" if time is None else "" for time in times],
            hovertemplate="%{x:.3g} rad: %{y:.3g} s%{text}",
        )  # fmt: skip
        if test.bound_s is not None:
            figure.add_scatter(
                x=distances, y=[test.bound_s] * len(distances), mode="lines",
                name=f"bound of {style.plain(test.law)}", legendgroup=group, showlegend=False,
                line={"color": colour, "width": 1.6, "dash": "dash"},
                hovertemplate="bound %{y:.3g} s",
            )  # fmt: skip
    style.apply(figure, 460)
    add_law_legend(figure)
    figure.update_layout(legend={"traceorder": "reversed"})
    figure.update_xaxes(
        type="log", title_text="initial error of every joint (rad)", tickvals=distances
    )
    figure.update_yaxes(title_text="settling time (s)", rangemode="tozero")
    return figure


def _symbol(start: Start) -> str:
    """A cross (at the top) for a start from which a law did not settle."""
    if start.settling_time_s is None:
        return "x-thin-open"
    return "circle" if start.bounds_kept else "circle-open"

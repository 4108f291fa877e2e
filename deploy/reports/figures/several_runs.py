"""Figures of several runs: a colour for each, one legend, bars by joint, settling times.

Functions that draw a whole figure give None where there is nothing to draw.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import plotly.graph_objects as go

from bus_schema.arrays import Matrix, Vector
from deploy.reports.figures import style
from deploy.reports.runs.run_numbers import SETTLING_BOUND, SETTLING_TIME, JointQuantity
from deploy.study.comparison.compared_runs import ComparedRuns
from deploy.study.comparison.settling import LONGEST_S, Start

_ENVELOPE_S = 0.05
_SMALLEST = 1e-6


def joint_bars(comparison: ComparedRuns, quantity: JointQuantity) -> go.Figure | None:
    """One number of every joint in every run, as bars on a logarithmic scale."""
    figure = style.new_figure(420, y_title=quantity.column.title)
    for run in comparison.runs:
        heights = [value or None for value in quantity.of_joints(run.result)]
        figure.add_bar(
            x=[style.plain(name) for name in run.result.tracking.joint_names],
            y=heights, name=style.plain(run.law), hovertemplate="%{y:.3g}",
            marker={"color": colour_of(comparison, run.law), "line": {"width": 0}},
        )  # fmt: skip
    if not any(height for bars in figure.data for height in bars.y):
        return None
    _add_legend(figure, comparison)
    figure.update_layout(barmode="group", bargap=0.25, bargroupgap=0.08)
    style.log_axis(figure, ticks=4)
    return figure


def _add_legend(figure: go.Figure, comparison: ComparedRuns) -> None:
    style.add_legend(figure, [run.law for run in comparison.runs])


def with_runs(rows: go.Figure, comparison: ComparedRuns) -> go.Figure:
    """A figure of rows, titles in ink, to which `add_run` adds a line per run in each."""
    rows.update_annotations(font={"size": 12, "color": style.INK})
    _add_legend(rows, comparison)
    return rows


def add_run(
    figure: go.Figure, comparison: ComparedRuns, law: str, x: Vector, rows: Iterable[Vector]
) -> None:
    """Add a run's line to each row of a figure; its first one stands in the legend."""
    for row, y in enumerate(rows, start=1):
        trace = style.line(x, y, colour_of(comparison, law), law, 1.3)
        trace.update(
            legendgroup=group_of(comparison, law),
            legendrank=comparison.colour_index(law) + 1,
            showlegend=row == 1,
        )
        figure.add_trace(trace, row=row, col=1)


def add_envelopes(
    figure: go.Figure, comparison: ComparedRuns, law: str, times_s: Vector, errors: Matrix
) -> None:
    """Add the largest |error| of each short stretch of time, one row per column of `errors`."""
    step_s = float(times_s[1] - times_s[0])
    starts = np.arange(0, len(times_s), max(1, round(_ENVELOPE_S / step_s)))
    largest = np.maximum.reduceat(np.abs(errors), starts, axis=0)
    shown = np.where(largest > _SMALLEST, largest, np.nan)
    add_run(figure, comparison, law, times_s[starts], shown.T)
    style.log_axis(figure)


def colour_of(comparison: ComparedRuns, law: str) -> str:
    """Colour of a run in all figures."""
    return style.palette(comparison.colour_index(law))


def group_of(comparison: ComparedRuns, law: str) -> str:
    """Group of a run's traces in a legend: what is switched off there disappears everywhere."""
    return f"law{comparison.colour_index(law)}"


def settling(comparison: ComparedRuns) -> go.Figure | None:
    """Settling time of every joint under every law, with the bound of those that have one."""
    figure = joint_bars(comparison, SETTLING_TIME)
    if figure is None:
        return None
    figure.update_yaxes(type="linear")
    for run in comparison.runs:
        bounds = SETTLING_BOUND.of_joints(run.result)
        if any(bound is not None for bound in bounds):
            colour = colour_of(comparison, run.law)
            figure.add_scatter(
                x=[style.plain(name) for name in run.result.tracking.joint_names], y=bounds,
                name=f"bound of {style.plain(run.law)}", mode="markers", showlegend=False,
                marker={"symbol": "line-ew-open", "size": 40, "color": colour, "line_width": 2},
            )  # fmt: skip
    return figure


def settling_from_afar(comparison: ComparedRuns) -> go.Figure | None:
    """Settling time over the size of the initial error, and one bound for all of them."""
    if not comparison.settling:
        return None
    figure = style.new_figure(460, "initial error of every joint (rad)", "settling time (s)")
    top_s = min(LONGEST_S, comparison.runs[0].data.setup.scenario.duration_s)
    for test in reversed(comparison.settling):  # the first law lies on top
        colour, group = colour_of(comparison, test.law), group_of(comparison, test.law)
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
                line={"color": colour, "width": 1.6, "dash": "dot"},
                hovertemplate="bound %{y:.3g} s",
            )  # fmt: skip
    _add_legend(figure, comparison)
    figure.update_layout(legend={"traceorder": "reversed"})
    figure.update_xaxes(type="log", tickvals=distances, tickangle=-45)
    figure.update_yaxes(rangemode="tozero")
    return figure


def _symbol(start: Start) -> str:
    """A cross (at the top) for a start from which a law did not settle."""
    if start.settling_time_s is None:
        return "x-thin-open"
    return "circle" if start.bounds_kept else "circle-open"

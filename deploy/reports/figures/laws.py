"""What figures of several laws have in common: a colour for each law, and a legend to hide them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import plotly.graph_objects as go

from bus_schema.arrays import Matrix, Vector
from deploy.comparison.comparison import Comparison
from deploy.reports.figures import style
from deploy.reports.quantities import JointQuantity

_ENVELOPE_S = 0.05
_SMALLEST = 1e-6
_LEGEND_ROWS = 3  # which six laws take


def joint_bars(comparison: Comparison, quantity: JointQuantity) -> go.Figure | None:
    """One number of every joint under every law, as bars on a logarithmic scale."""
    figure = go.Figure()
    for run in comparison.runs:
        heights = [value or None for value in quantity.of_joints(run.summary)]
        figure.add_bar(
            x=[style.plain(name) for name in run.summary["tracking"]["joint_names"]],
            y=heights, name=style.plain(run.law), hovertemplate="%{y:.3g}",
            marker={"color": law_colour(comparison, run.law), "line": {"width": 0}},
        )  # fmt: skip
    if not any(height for bars in figure.data for height in bars.y):
        return None
    style.apply(figure, 420)
    add_law_legend(figure)
    figure.update_layout(barmode="group", bargap=0.25, bargroupgap=0.08)
    figure.update_yaxes(title_text=quantity.column.title)
    style.log_axis(figure, ticks=4)
    return figure


def with_law_legend(rows: go.Figure) -> go.Figure:
    """A figure of rows, to which `add_law` adds a line per law in each."""
    rows.update_annotations(font={"size": 12, "color": style.INK})
    add_law_legend(rows)
    return rows


def add_law(
    figure: go.Figure, comparison: Comparison, law: str, x: Vector, rows: Iterable[Vector]
) -> None:
    """Add a law's line to each row of a figure; its first one stands in the legend."""
    for row, y in enumerate(rows, start=1):
        trace = style.line(x, y, law_colour(comparison, law), law, 1.3)
        trace.update(
            legendgroup=law_group(comparison, law),
            legendrank=comparison.colour_index(law) + 1,
            showlegend=row == 1,
        )
        figure.add_trace(trace, row=row, col=1)


def add_envelopes(
    figure: go.Figure, comparison: Comparison, law: str, times_s: Vector, errors: Matrix
) -> None:
    """Add the largest |error| of each short stretch of time, one row per column of `errors`."""
    step_s = float(times_s[1] - times_s[0])
    starts = np.arange(0, len(times_s), max(1, round(_ENVELOPE_S / step_s)))
    largest = np.maximum.reduceat(np.abs(errors), starts, axis=0)
    shown = np.where(largest > _SMALLEST, largest, np.nan)
    add_law(figure, comparison, law, times_s[starts], shown.T)
    style.log_axis(figure)


def law_colour(comparison: Comparison, law: str) -> str:
    """Colour of a law in all figures."""
    return style.palette(comparison.colour_index(law))


def law_group(comparison: Comparison, law: str) -> str:
    """Group of a law's traces in a legend: what is switched off there disappears everywhere."""
    return f"law{comparison.colour_index(law)}"


def add_law_legend(figure: go.Figure) -> None:
    """A legend of laws in two columns."""
    style.put_legend_on_top(figure, _LEGEND_ROWS, entrywidthmode="fraction", entrywidth=0.48)

"""What all figures have in common: colours, fonts, and one row per joint."""

from __future__ import annotations

import html

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from bus_schema.arrays import Vector
from deploy.reports.figures.decimation import decimate

FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"
INK, MUTED, GRID, BAND, ALARM = "#1f2933", "#7b8794", "#e9edf1", "rgba(0,114,178,0.11)", "#c0392b"
_JOINTS = ("#0072b2", "#d55e00", "#009e73", "#a3508b", "#b07d00", "#3a9bd9", "#5b5b5b")
_ROW_GAP_PX, _TOP_PX, _BOTTOM_PX = 34, 34, 50


def joint_colour(joint: int) -> str:
    """Colour of a joint in every figure; after Okabe and Ito, darkened to be read on white."""
    return _JOINTS[joint % len(_JOINTS)]


def line(times_s: Vector, values: Vector, colour: str, name: str, width: float = 1.4) -> go.Scatter:
    """A series over time, decimated."""
    x, y = decimate(times_s, values)
    return go.Scatter(x=x, y=y, name=name, mode="lines", line={"color": colour, "width": width})


def band(times_s: Vector, upper: Vector, lower: Vector) -> tuple[go.Scatter, go.Scatter]:
    """The bounds −lower < e < upper over time, as two traces with the shade between them."""
    edge = {"color": "rgba(0,114,178,0.45)", "width": 1}
    return (
        go.Scatter(x=times_s, y=upper, name="upper bound", mode="lines", line=edge),
        go.Scatter(
            x=times_s, y=lower, name="lower bound", mode="lines", line=edge,
            fill="tonexty", fillcolor=BAND,
        ),
    )  # fmt: skip


def joint_rows(names: tuple[str, ...], unit: str) -> go.Figure:
    """A figure with one row per joint over a common time axis.

    Args:
        names: names of the joints, the titles of their rows.
        unit: title of every vertical axis.
    """
    rows = len(names)
    row_px = float(np.clip(520 / rows, 100, 170))
    plot_px = rows * row_px + (rows - 1) * _ROW_GAP_PX
    figure = make_subplots(
        rows=rows,
        cols=1,
        shared_xaxes=True,
        vertical_spacing=_ROW_GAP_PX / plot_px if rows > 1 else 0.0,
        subplot_titles=[html.escape(name) for name in names],
    )
    for joint, title in enumerate(figure.layout.annotations):
        title.update(x=0, xanchor="left", font={"size": 12, "color": joint_colour(joint)})
    style(figure, plot_px + _TOP_PX + _BOTTOM_PX)
    figure.update_yaxes(title={"text": unit, "font": {"size": 11}, "standoff": 4}, nticks=5)
    figure.update_xaxes(title_text="time (s)", row=rows)
    return figure


def style(figure: go.Figure, height_px: float, *, legend: bool = False) -> None:
    """Give a figure the report's looks."""
    figure.update_layout(
        template="plotly_white",
        height=round(height_px),
        margin={"l": 62, "r": 14, "t": _TOP_PX, "b": _BOTTOM_PX},
        font={"family": FONT, "size": 12, "color": INK},
        hoverlabel={"font": {"family": FONT}},
        showlegend=legend,
        legend={"orientation": "h", "x": 0, "y": -0.2, "yanchor": "top"},
    )
    axis = {"gridcolor": GRID, "zerolinecolor": "#cbd2d9", "linecolor": "#cbd2d9"}
    figure.update_xaxes(**axis, showline=True, ticks="outside", tickcolor="#cbd2d9")
    figure.update_yaxes(**axis, exponentformat="power")

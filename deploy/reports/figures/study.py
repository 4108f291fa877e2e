"""Figures of studies: curves with their spread, bars, and heat maps; every point knows its rerun.

The command that runs a point again is its `customdata`, which the page shows on a click.
"""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import plotly.graph_objects as go

from deploy.reports.figures.style import joint_colour, style
from deploy.reports.study_text import shown_value
from deploy.study.statistics import Spread

_DASHES = ("solid", "dot", "dash", "dashdot")
_LEGEND_ROW_PX, _TOOLBAR_PX, _LETTER_PX, _NARROW_NAME = 21, 26, 7.5, 10
_HEAT = [[0.0, "#f3f8fb"], [0.5, "#6aa5cc"], [1.0, "#0b3c5d"]]


@dataclass(frozen=True)
class Curve:
    """One line over a swept value.

    Attributes:
        name: for the legend.
        colour: number of its colour.
        dash: number of its dash pattern.
        x: swept values, numbers or texts.
        spreads: what is drawn: mean as a line, extremes as a band.
        reruns: command of each point.
    """

    name: str
    colour: int
    dash: int
    x: Sequence[Any]
    spreads: Sequence[Spread]
    reruns: Sequence[str]


def curves(
    lines: Sequence[Curve], x_title: str, y_title: str, factor: float = 1.0, *, log: bool = False
) -> go.Figure | None:
    """Lines over a swept value, each with the band from its lowest to its highest run."""
    figure = go.Figure()
    for line in lines:
        _add_curve(figure, line, factor, log=log)
    if not any(value is not None for trace in figure.data for value in trace.y):
        return None
    style(figure, 430)
    _put_legend_on_top(figure, [html.escape(line.name) for line in lines])
    figure.update_xaxes(title_text=html.escape(x_title))
    figure.update_yaxes(title_text=html.escape(y_title))
    if log:
        figure.update_yaxes(type="log", dtick=1, tickformat="~g")
    else:
        figure.update_yaxes(rangemode="tozero")
    return figure


@dataclass(frozen=True)
class Bar:
    """One bar.

    Attributes:
        group: what it shares its colour with, where there is more than one group.
        name: what it stands at.
        height: nothing is drawn for None.
        text: its height in words.
        rerun: command of its point.
    """

    group: str
    name: str
    height: float | None
    text: str
    rerun: str


def bars(all_bars: Sequence[Bar], y_title: str) -> go.Figure | None:
    """Bars by name, and side by side by group."""
    figure = go.Figure()
    groups = list(dict.fromkeys(bar.group for bar in all_bars))
    for index, group in enumerate(groups):
        members = [bar for bar in all_bars if bar.group == group]
        own = [joint_colour(number) for number in range(len(members))]
        figure.add_trace(
            go.Bar(
                x=[html.escape(bar.name) for bar in members],
                y=[bar.height or 0.0 for bar in members], text=[bar.text for bar in members],
                textposition="outside", cliponaxis=False, name=html.escape(group),
                constraintext="none", textangle=0, textfont={"size": 10},
                customdata=[bar.rerun for bar in members], hovertemplate="%{x}: %{text}",
                marker={"color": joint_colour(index) if len(groups) > 1 else own},
            )
        )  # fmt: skip
    if not all_bars:
        return None
    style(figure, 430)
    if len(groups) > 1:
        _put_legend_on_top(figure, groups)
    figure.update_layout(barmode="group", bargap=0.3, bargroupgap=0.06)
    figure.update_yaxes(title_text=html.escape(y_title), rangemode="tozero")
    return figure


def heat_map(
    x: tuple[str, Sequence[Any]], y: tuple[str, Sequence[Any]],
    values: Sequence[Sequence[float | None]], reruns: Sequence[Sequence[str]], unit: str,
) -> go.Figure:  # fmt: skip
    """A field of numbers over two swept keys.

    Args:
        x: title and values of the horizontal axis.
        y: title and values of the vertical axis.
        values: a row per value of `y`; None leaves a field white.
        reruns: command of each field, alike.
        unit: what the numbers are.
    """
    shown = [["" if value is None else f"{value:.3g}" for value in row] for row in values]
    known = [value for row in values for value in row if value is not None]
    crowded = len(x[1]) * len(y[1]) > 150
    field = go.Heatmap(
        x=[shown_value(value) for value in x[1]], y=[shown_value(value) for value in y[1]],
        z=values, zmin=0.0, zmax=max(known, default=0.0) or 1.0,
        customdata=reruns, text=shown, texttemplate=None if crowded else "%{text}",
        colorscale=_HEAT, xgap=1, ygap=1, hoverongaps=False,
        colorbar={"title": {"text": html.escape(unit), "side": "right"}, "thickness": 12},
        hovertemplate="%{x} · %{y}: %{text}<extra></extra>",
    )  # fmt: skip
    figure = go.Figure(field)
    style(figure, 140 + max(240, min(34 * len(y[1]), 600)))
    figure.update_xaxes(title_text=html.escape(x[0]), type="category", showgrid=False)
    figure.update_yaxes(title_text=html.escape(y[0]), type="category", showgrid=False)
    return figure


def _add_curve(figure: go.Figure, line: Curve, factor: float, *, log: bool) -> None:
    def drawn(name: str) -> list[float | None]:
        values = (spread[name] for spread in line.spreads)
        return [None if v is None or (log and v <= 0.0) else factor * v for v in values]

    colour = joint_colour(line.colour)
    name, group = html.escape(line.name), f"{line.colour}-{line.dash}"
    known = [
        ends
        for ends in zip(line.x, drawn("lowest"), drawn("highest"), strict=True)
        if ends[1] is not None
    ]
    if any(lowest != highest for _, lowest, highest in known):
        figure.add_trace(
            go.Scatter(
                x=[end[0] for end in known] + [end[0] for end in reversed(known)],
                y=[end[2] for end in known] + [end[1] for end in reversed(known)],
                fill="toself", fillcolor=_pale(colour), line={"width": 0}, mode="lines",
                hoverinfo="skip", showlegend=False, legendgroup=group,
            )
        )  # fmt: skip
    figure.add_trace(
        go.Scatter(
            x=list(line.x), y=drawn("mean"), name=name, legendgroup=group, mode="lines+markers",
            line={"color": colour, "width": 2, "dash": _DASHES[line.dash % len(_DASHES)]},
            marker={"size": 7}, customdata=list(line.reruns), hovertemplate="%{x}: %{y:.3g}",
        )
    )  # fmt: skip


def _pale(colour: str) -> str:
    red, green, blue = (int(colour[start : start + 2], 16) for start in (1, 3, 5))
    return f"rgba({red},{green},{blue},0.14)"


def _put_legend_on_top(figure: go.Figure, names: Sequence[str]) -> None:
    """Between toolbar and plot; in as many columns as fit, with room for what narrow pages take."""
    widest = max(map(len, names), default=0)
    rows = len(names) if widest > _NARROW_NAME else -(-len(names) // 2)
    added = _TOOLBAR_PX + _LEGEND_ROW_PX * rows
    height = figure.layout.height + added
    figure.update_layout(
        height=height,
        margin={"t": figure.layout.margin.t + added},
        showlegend=True,
        legend={
            "x": 0, "xanchor": "left", "y": 1.0 - _TOOLBAR_PX / height, "yanchor": "top",
            "yref": "container", "traceorder": "normal", "entrywidthmode": "pixels",
            "entrywidth": _LETTER_PX * widest,
        },
    )  # fmt: skip

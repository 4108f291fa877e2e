"""Common parts of all figures: colours, fonts, thinned series, one row per joint, and their JSON.

Figures are made without the template of their looks, and get it when they are written or handed
out: as an object of Plotly's, loading and checking it would take as long as making all figures of
a report.
"""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Mapping, Sequence
from functools import cache, lru_cache
from typing import Any

import numpy as np
import plotly.graph_objects as go
import plotly.io as pio
from plotly.io.json import to_json_plotly
from plotly.subplots import make_subplots

from bus_schema.arrays import Matrix, Vector
from bus_schema.messages.topics import Topic
from deploy.judge.run_data import RunData
from deploy.reports.page import typed_array
from deploy.reports.tables import without_middle

FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"
INK, MUTED, GRID, BAND, ALARM = "#1f2933", "#7b8794", "#e9edf1", "rgba(0,114,178,0.11)", "#c0392b"
_PALETTE = ("#0072b2", "#d55e00", "#009e73", "#a3508b", "#b07d00", "#3a9bd9", "#5b5b5b")
TOP_PX, BOTTOM_PX, _ROW_GAP_PX = 34, 50, 34
_TITLE_LETTERS = 36  # as wide as a figure on a telephone
_BUTTONS_PX, _LEGEND_ROW_PX, _ROW_TITLE_PX = 27, 21, 18
_LETTER_PX, _NARROW_NAME = 7.5, 10
MAX_POINTS = 4000
MRAD = MM = 1e3
DOTTED = {"color": MUTED, "width": 1, "dash": "dot"}
"""A limit, in all figures."""
BOUNDS = "bounds"
"""Name of the bounds in a figure of errors."""
SHOULD_BE = {"color": "rgba(123,135,148,0.55)", "width": 4.5}
"""Style of the line on which another one should lie."""
_AXIS = {"gridcolor": GRID, "zerolinecolor": "#cbd2d9", "linecolor": "#cbd2d9"}
_OURS = {
    "margin": {"l": 62, "r": 14, "t": TOP_PX, "b": BOTTOM_PX},
    "font": {"family": FONT, "size": 12, "color": INK},
    "hoverlabel": {"font": {"family": FONT}},
    "legend": {"orientation": "h", "x": 0, "y": -0.2, "yanchor": "top"},
    "xaxis": {**_AXIS, "showline": True, "ticks": "outside", "tickcolor": "#cbd2d9"},
    "yaxis": {**_AXIS, "exponentformat": "power"},
}


def palette(index: int) -> str:
    """Colour of a joint or a law, by number; after Okabe and Ito, darkened to be read on white."""
    return _PALETTE[index % len(_PALETTE)]


def plain(text: str) -> str:
    """Text as it is shown in a figure, where plotly would read it as HTML."""
    return html.escape(text)


def new_figure(
    height_px: float,
    x_title: str = "",
    y_title: str = "",
    traces: Iterable[Any] = (),
    *,
    legend: bool = False,
) -> go.Figure:
    """Return a figure with the titles of its axes; texts may be of anybody."""
    made = go.Figure(list(traces), {"template": "none"})
    apply(made, height_px, legend=legend)
    if x_title:
        made.update_xaxes(title_text=plain(x_title).replace(", ", ",<br>"))
    if y_title:
        made.update_yaxes(title_text=plain(y_title))
    return made


def line(times_s: Vector, values: Vector, colour: str, name: str, width: float = 1.4) -> go.Scatter:
    """A series over time, decimated."""
    x, y = decimate(times_s, values)
    return go.Scatter(
        x=x, y=y, name=plain(name), mode="lines", line={"color": colour, "width": width}
    )


def band(times_s: Vector, upper: Vector, lower: Vector) -> tuple[go.Scatter, go.Scatter]:
    """The bounds −lower < e < upper over time, as two traces with the shade between them."""
    edge = {**DOTTED, "color": "rgba(0,114,178,0.45)"}
    return (
        go.Scatter(x=times_s, y=upper, name=BOUNDS, mode="lines", line=edge),
        go.Scatter(
            x=times_s, y=lower, name=BOUNDS, mode="lines", line=edge,
            fill="tonexty", fillcolor=BAND,
        ),
    )  # fmt: skip


def joint_rows(names: tuple[str, ...], unit: str, quantity: str = "") -> go.Figure:
    """A figure with one row per joint over a common time axis.

    Args:
        names: names of the joints, the titles of their rows.
        unit: title of every vertical axis.
        quantity: what is drawn, for papers, where a figure has no title.
    """
    figure = go.Figure(_empty_joint_rows(names))
    figure.update_yaxes(title={"text": unit, "font": {"size": 11}, "standoff": 4}, nticks=5)
    return figure.update_layout(meta=quantity or None)


@lru_cache(maxsize=1)
def _empty_joint_rows(names: tuple[str, ...]) -> go.Figure:
    """Return a template to copy: Plotly copies a figure in a fraction of the time it makes one."""
    rows = len(names)
    row_px = float(np.clip(520 / rows, 100, 170))
    plot_px = rows * row_px + (rows - 1) * _ROW_GAP_PX
    figure = make_subplots(
        figure=new_figure(plot_px),
        rows=rows,
        cols=1,
        shared_xaxes=True,
        vertical_spacing=_ROW_GAP_PX / plot_px if rows > 1 else 0.0,
        subplot_titles=[plain(without_middle(name, _TITLE_LETTERS)) for name in names],
    )
    for joint, title in enumerate(figure.layout.annotations):
        title.update(x=0, xanchor="left", font={"size": 12, "color": palette(joint)})
    apply(figure, plot_px + TOP_PX + BOTTOM_PX)
    figure.update_xaxes(title_text="time (s)", row=rows)
    return figure


def apart(begins: Vector, ends: Vector) -> Vector:
    """Return lines from begins to ends, with a gap after each."""
    return np.stack([begins, ends, np.full(len(begins), np.nan)], axis=1).ravel()


def joint_series(run: RunData, topic: Topic, field: str, unit: str) -> go.Figure | None:
    """One field of a topic over time, a row per joint; None if it never has a value."""
    values = per_joint(run, topic, field)
    if not np.isfinite(values).any():
        return None
    names = run.setup.robot.joint_names
    figure = joint_rows(names, unit)
    for joint, name in enumerate(names):
        trace = line(run.times_s(topic), values[:, joint], palette(joint), name)
        figure.add_trace(trace, row=joint + 1, col=1)
    return figure


def per_joint(run: RunData, topic: Topic, field: str) -> Matrix:
    """A field of a topic, shape (messages, joints)."""
    return np.asarray(run.tables[topic.name][field].reshape(-1, run.setup.robot.joints))


def apply(figure: go.Figure, height_px: float, *, legend: bool = False) -> None:
    """Give a figure its height, and a legend where that is asked for."""
    figure.update_layout(height=round(height_px), showlegend=legend)


def log_axis(figure: go.Figure, ticks: int = 3) -> None:
    """Make the vertical axes logarithmic, with ticks also where they span less than a decade.

    Args:
        figure: the figure.
        ticks: about how many there are, also after zooming in; three are enough for a row.
    """
    figure.update_yaxes(type="log", nticks=ticks, tickformat="~g")


def put_legend_on_top(figure: go.Figure, rows: int, **entries: object) -> None:
    """Put a legend on top of a figure, its blank title beside plotly's buttons in the corner.

    Plotly gives the plot what the legend leaves of the height, at any width of the page.

    Args:
        figure: the figure, with its style.
        rows: how many rows its legend takes on a narrow page.
        entries: layout of the legend's entries.
    """
    plot_px = figure.layout.height - TOP_PX - BOTTOM_PX
    room_px = _ROW_TITLE_PX if figure.layout.annotations else 0
    figure.update_layout(
        height=figure.layout.height + _BUTTONS_PX + _LEGEND_ROW_PX * rows,
        showlegend=True,
        legend={
            "x": 0, "xanchor": "left", "y": 1.0 + room_px / plot_px, "yanchor": "bottom",
            "title": {"text": " ", "side": "top", "font": {"size": _BUTTONS_PX / 1.3}},
            "traceorder": "normal", **entries,
        },
    )  # fmt: skip


def add_legend(figure: go.Figure, names: Sequence[str]) -> None:
    """Add a legend in as many columns as fit, with room for what narrow pages take."""
    widest = max(map(len, names), default=0)
    rows = len(names) if widest > _NARROW_NAME else -(-len(names) // 2)
    put_legend_on_top(figure, rows, entrywidthmode="pixels", entrywidth=_LETTER_PX * widest)


def decimate(x: Vector, y: Vector, max_points: int = MAX_POINTS) -> tuple[Vector, Vector]:
    """The smallest and the largest y of each of max_points / 2 equally long stretches, in order.

    A series of at most `max_points` comes back as it is. NaN is passed over, unless a stretch has
    nothing else.

    Args:
        x: shape (points,).
        y: shape (points,).
        max_points: at least 2.
    """
    if len(y) <= max_points:
        return x, y
    length = -(-len(y) // (max_points // 2))
    stretches = np.pad(y, (0, -len(y) % length), constant_values=np.nan).reshape(-1, length)
    starts, unknown = np.arange(len(stretches)) * length, np.isnan(stretches)
    lowest = starts + np.where(unknown, np.inf, stretches).argmin(axis=1)
    highest = starts + np.where(unknown, -np.inf, stretches).argmax(axis=1)
    kept = np.union1d(lowest, highest)
    return x[kept], y[kept]


@cache
def template() -> dict[str, Any]:
    """Return Plotly's own template on white with our changes, as it stands in a figure's JSON."""
    plotlys = pio.templates["plotly_white"].to_plotly_json()
    return {"layout": _merged(plotlys["layout"], _OURS)}


def _merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return a nested table in which each change replaces the value in `base`."""
    return {
        **base,
        **{
            key: _merged(base.get(key, {}), value) if isinstance(value, dict) else value
            for key, value in changes.items()
        },
    }


def figure_json(figure: go.Figure) -> str:
    """Return a figure as plotly.js reads it, with the common template."""
    return str(to_json_plotly(_packed(with_template(figure.to_dict()))))


def with_template(figure: dict[str, Any]) -> dict[str, Any]:
    """Return a figure's JSON with the common template."""
    return {**figure, "layout": {**figure["layout"], "template": template()}}


def _packed(value: Any) -> Any:
    """Return a part of a figure with its arrays, which Plotly has packed, made half as large."""
    if isinstance(value, dict):
        if value.get("dtype") == "f8" and "shape" not in value:
            return typed_array(np.frombuffer(base64.b64decode(value["bdata"]), "<f8"))
        return {key: _packed(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_packed(each) for each in value]
    return value

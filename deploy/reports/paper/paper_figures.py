"""Figures of a report as a paper prints them: PDF or SVG, for one column or two.

A report's figures are Plotly's, which needs a browser for a file of vectors. So their traces are
drawn once more with Matplotlib: lines, markers, bands and bars, one row per subplot.
"""

from __future__ import annotations

import html
import math
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

WIDTHS_MM = {1: 88.0, 2: 181.0}
"""Width of a figure over one column and over two, as in IEEE's journals."""
_ROW_MM, _FRAME_MM = 24.0, 26.0
_INCH_MM = 25.4
_STYLE: Any = {
    "font.family": "serif", "font.serif": ["STIXGeneral"], "mathtext.fontset": "stix",
    "font.size": 8.0, "axes.labelsize": 8.0, "axes.titlesize": 8.0, "legend.fontsize": 7.0,
    "xtick.labelsize": 7.0, "ytick.labelsize": 7.0, "axes.linewidth": 0.5, "axes.grid": True,
    "grid.linewidth": 0.3, "grid.color": "#d0d0d0", "pdf.fonttype": 42, "svg.fonttype": "path",
    "svg.hashsalt": "funnel-hil", "lines.linewidth": 0.9, "lines.markersize": 3.0,
}  # fmt: skip
"""Fonts are embedded, as publishers ask; the same result gives the same bytes."""
_NO_DATE: dict[str, dict[str, Any]] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}
_DASHES = {"dot": ":", "dash": "--", "dashdot": "-.", "solid": "-"}
_MARKERS = {"circle": "o", "diamond": "D", "square": "s", "cross": "P", "x": "X"}
_RGBA = re.compile(r"rgba?\(([^)]*)\)")
_TAG = re.compile(r"<[^>]+>")


def can_be_drawn(figure: object) -> bool:
    """Whether a panel has a figure that this module draws: in the plane, of lines or columns."""
    return (
        isinstance(figure, go.Figure)
        and bool(figure.data)
        and all(
            trace.type == "scatter" or (trace.type == "bar" and trace.orientation != "h")
            for trace in figure.data
        )
    )


def write_figure(figure: go.Figure, file: Path, columns: int) -> None:
    """Write a figure to a PDF or SVG file.

    Args:
        figure: one that `can_be_drawn`.
        file: its name; the ending is the format.
        columns: 1 or 2 columns of the page that it stands over.
    """
    with rc_context(_STYLE):
        rows = _rows(figure)
        height_mm = _FRAME_MM + _ROW_MM * (len(rows) if len(rows) > 1 else 1.6)
        size = (WIDTHS_MM[columns] / _INCH_MM, height_mm / _INCH_MM)
        drawn = Figure(size, layout="constrained")
        axes = drawn.subplots(len(rows), 1, squeeze=False, sharex=len(rows) > 1)[:, 0]
        titles = [_text(each.text) for each in figure.layout.annotations]
        for index, (row, at) in enumerate(zip(rows, axes, strict=True)):
            _draw_row(figure, row, at)
            if len(titles) == len(rows):
                at.set_title(titles[index], loc="left", pad=2.0)
            if index < len(rows) - 1:
                at.set_xlabel("")
        _put_legend(drawn, axes)
        drawn.savefig(file, metadata=_NO_DATE[file.suffix[1:]])


def _rows(figure: go.Figure) -> list[str]:
    """Return the vertical axes that traces use, from the top down."""
    used = list(dict.fromkeys(trace.yaxis or "y" for trace in figure.data))
    return sorted(used, key=lambda name: -((_axis(figure, name).domain or (0.0,))[0]))


def _axis(figure: go.Figure, name: str) -> Any:
    return figure.layout[f"{name[0]}axis{name[1:]}"]


def _draw_row(figure: go.Figure, row: str, at: Axes) -> None:
    traces = [trace for trace in figure.data if (trace.yaxis or "y") == row]
    _draw_bars([trace for trace in traces if trace.type == "bar"], figure.layout.bargap, at)
    lines = [trace for trace in traces if trace.type != "bar"]
    for before, trace in zip([None, *lines], lines, strict=False):
        _draw_line(trace, before, at)
    _draw_levels(figure, row, at)
    across, along = _axis(figure, row), _axis(figure, traces[0].xaxis or "x")
    for axis, scale, limit, label in (
        (along, at.set_xscale, at.set_xlim, at.set_xlabel),
        (across, at.set_yscale, at.set_ylim, at.set_ylabel),
    ):
        is_log = axis.type == "log"
        if is_log:
            scale("log")
        if axis.range is not None and all(isinstance(end, int | float) for end in axis.range):
            limit(*(10.0**end if is_log else end for end in axis.range))
        if axis.title.text:
            label(_text(axis.title.text))
        if axis.tickvals is not None and axis.ticktext is not None:
            ticks = at.set_xticks if axis is along else at.set_yticks
            ticks(list(axis.tickvals), [_text(text) for text in axis.ticktext])
            (at.xaxis if axis is along else at.yaxis).minorticks_off()


def _draw_bars(bars: Sequence[Any], gap: float | None, at: Axes) -> None:
    """Draw bars at their numbers, or at names, side by side."""
    names = list(dict.fromkeys(x for trace in bars for x in trace.x))
    has_names = any(isinstance(x, str) for x in names)
    places = {x: float(index if has_names else x) for index, x in enumerate(names)}
    room = min(np.diff(sorted(places.values())), default=1.0) * (1.0 - (gap or 0.0))
    width = room / max(len(bars), 1)
    for number, trace in enumerate(bars):
        off = (number - 0.5 * (len(bars) - 1)) * width
        heights = [math.nan if y is None else y for y in trace.y]
        own = trace.marker.color
        colour = [*map(_colour, own)] if isinstance(own, list | tuple) else _colour(own)
        at.bar([places[x] + off for x in trace.x], heights, width, label=_text(trace.name),
               color=colour)  # fmt: skip
    if has_names:
        at.set_xticks(list(places.values()), [_text(name) for name in names])


def _draw_levels(figure: go.Figure, row: str, at: Axes) -> None:
    """Draw lines across a whole row, such as a bound."""
    for shape in figure.layout.shapes:
        style = {
            "color": _colour(shape.line.color), "linewidth": 0.6,
            "linestyle": _DASHES.get(shape.line.dash or "solid", "-"),
        }  # fmt: skip
        if shape.type == "line" and shape.yref == row and shape.y0 == shape.y1:
            at.axhline(shape.y0, **style)
        elif shape.type == "line" and shape.yref == f"{row} domain" and shape.x0 == shape.x1:
            at.axvline(shape.x0, **style)


def _draw_line(trace: Any, before: Any, at: Axes) -> None:
    """Draw a line or markers, and the band between it and the trace before."""
    mode = trace.mode or "lines"
    own = trace.marker.color if isinstance(trace.marker.color, str) else None
    colour = _colour(trace.line.color or own)
    symbols = trace.marker.symbol
    by_point = isinstance(symbols, list | tuple)
    style: dict[str, Any] = {"label": _text(trace.name), "color": colour}
    if trace.fill == "tonexty" and before is not None:
        at.fill_between(trace.x, before.y, trace.y, color=_colour(trace.fillcolor), linewidth=0)
    if by_point and "lines" not in mode:
        for number, (x, y, symbol) in enumerate(zip(trace.x, trace.y, symbols, strict=True)):
            shown = style if number == 0 else {"color": colour}
            at.plot([x], [y], linestyle="", marker=_MARKERS.get(symbol, "o"), **shown)
        return
    at.plot(
        trace.x, trace.y,
        linestyle=_DASHES.get(trace.line.dash or "solid", "-") if "lines" in mode else "",
        marker=_MARKERS.get(symbols or "circle", "o") if "markers" in mode else "",
        drawstyle="steps-post" if trace.line.shape == "hv" else "default", **style,
    )  # fmt: skip


def _put_legend(drawn: Figure, axes: Iterable[Axes]) -> None:
    """Put one legend over all rows, with each name once; none where there is a single name."""
    entries: dict[str, Any] = {}
    for at in axes:
        for handle, label in zip(*at.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    if len(entries) > 1:
        drawn.legend(
            entries.values(), entries.keys(), loc="outside upper left", ncols=3, frameon=False
        )


def _text(text: str | None) -> str:
    """Return a text of Plotly's, which is HTML, as it is read; Matplotlib reads $ as formulas."""
    return html.unescape(_TAG.sub(" ", text or "")).strip().replace("$", r"\$") or "_nolegend_"


def _colour(colour: Any) -> Any:
    """Return a CSS colour as Matplotlib has it; black for none."""
    found = _RGBA.fullmatch(colour) if isinstance(colour, str) else None
    if found is None:
        return colour if isinstance(colour, str) else "black"
    parts = [float(part) for part in found[1].split(",")]
    return (*(part / 255.0 for part in parts[:3]), *(parts[3:] or [1.0]))

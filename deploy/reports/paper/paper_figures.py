"""Figures of a report as a paper prints them: PDF or SVG, for one column or two.

A report's figures are Plotly's, which needs a browser for a file of vectors. So their traces are
drawn once more with Matplotlib: lines, markers, bands and bars, one row per subplot.
"""

from __future__ import annotations

import html
import math
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from deploy.reports.figures.style import BOUNDS, INK, palette
from deploy.reports.paper.paper_axes import share_labels, turn_crowded_names, write_plain_powers
from deploy.reports.paper.paper_legend import HIGHEST_MM, INCH_MM, put_legend

WIDTHS_MM = {1: 88.0, 2: 181.0}
"""Width of a figure over one column and over two, as in IEEE's journals."""
_ROW_MM, _FRAME_MM = 24.0, 26.0
_MOST_ROWS, _FOLDED = 2, {1: 2, 2: 4}
"""More rows of one subplot each stand side by side: so many, over one column and over two."""
_FARTHEST_LEVEL = 0.5
"""A level farther beyond the data than this, in their span, is left out: it would flatten them."""
_STYLE: Any = {
    "font.family": "serif", "font.serif": ["STIXGeneral"], "mathtext.fontset": "stix",
    "font.size": 8.0, "axes.labelsize": 8.0, "axes.titlesize": 8.0, "legend.fontsize": 8.0,
    "xtick.labelsize": 8.0, "ytick.labelsize": 8.0, "axes.linewidth": 0.5, "axes.grid": True,
    "axes.axisbelow": True, "grid.linewidth": 0.3, "grid.color": "#d0d0d0", "pdf.fonttype": 42,
    "svg.fonttype": "path", "svg.hashsalt": "funnel-hil", "lines.linewidth": 0.9,
    "lines.markersize": 3.0,
}  # fmt: skip
"""Fonts are embedded, as publishers ask; the same result gives the same bytes."""
_NO_DATE: dict[str, dict[str, Any]] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}
_DASHES = {"dot": ":", "dash": "--", "dashdot": "-.", "solid": "-"}
_MARKERS = {"circle": "o", "diamond": "D", "square": "s", "cross": "P", "x": "X",
            "triangle-up": "^", "triangle-down": "v", "line-ew-open": "_"}  # fmt: skip
"""Those of matplotlib for those of plotly; others are circles."""
_OWN_MARKERS = ("", "s", "^", "D", "v", "P", "X", "<", ">")
_SCATTER_MARKERS = ("o", *_OWN_MARKERS[1:])
_ROUND = (None, "circle", "circle-open")
"""Markers that say nothing; hollow ones of several shapes are seen where lines coincide."""
_FILLS = ("full", "none", "left", "right", "top", "bottom")
"""Of points whose shapes say something else than their colours."""
_HATCHES = ("", "////", "....", "xxxx", "\\\\\\\\", "++++", "oo", "**")
"""Of colours in their order, so that they differ in grey too."""
_MARKED_POINTS = 8
_THICK_PX, _PT_OF_PX = 4.0, 0.4
"""Lines so thick on screen are thick on paper too, and have no markers."""
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
        figure = _of_one_colour(figure)
        grid = _grid(figure)
        if is_folded := len(grid) > _MOST_ROWS and all(len(row) == 1 for row in grid):
            grid = _folded(grid, _FOLDED[columns])
        height_mm = _FRAME_MM + _ROW_MM * (len(grid) if len(grid) > 1 else 1.6)
        size = (WIDTHS_MM[columns] / INCH_MM, min(height_mm, HIGHEST_MM) / INCH_MM)
        drawn = Figure(size, layout="constrained")
        is_shared = not is_folded and all(len(_titles(figure, row)) < 2 for row in grid)
        axes = drawn.subplots(
            len(grid), len(grid[0]), squeeze=False, sharex=len(grid) > 1,
            sharey="row" if is_shared else "none",
        )  # fmt: skip
        titles = [_text(each.text) for each in figure.layout.annotations]
        heads = [name for row in grid for name in (row if is_folded else row[:1])]
        for row, places in zip(grid, axes, strict=True):
            for name, at in zip(row, places, strict=False):
                _draw_row(figure, name, at)
                if len(titles) == len(heads) and name in heads:
                    at.set_title(titles[heads.index(name)], loc="left", pad=2.0)
                if is_shared:
                    at.label_outer()
            for at in places[len(row) :]:
                at.set_visible(False)
        share_labels(drawn, axes, has_own_scales=not is_shared)
        turn_crowded_names(drawn, axes)
        write_plain_powers(axes)
        has_level = any(shape.showlegend for shape in figure.layout.shapes)
        put_legend(drawn, axes, titles, least=1 if has_level else 2)
        drawn.savefig(file, metadata=_NO_DATE[file.suffix[1:]])


def _of_one_colour(figure: go.Figure) -> go.Figure:
    """Return a figure whose lines of one name have one colour in all rows, if they are alone there.

    Such a colour only repeats the title of a row, as a joint's, and a legend could not have it.
    """
    colours: dict[str, dict[str, set[Any]]] = {}
    for trace in figure.data:
        if trace.type == "scatter" and trace.name:
            own = colours.setdefault(trace.name, {}).setdefault(trace.yaxis or "y", set())
            own.add(trace.line.color)
    shared = {
        name for name, by_row in colours.items()
        if len(by_row) > 1 and all(len(own) == 1 for own in by_row.values())
    }  # fmt: skip
    made, first = go.Figure(figure), dict[str, Any]()
    for trace in made.data:
        if trace.name in shared:
            trace.line.color = first.setdefault(trace.name, trace.line.color)
    return made


def _grid(figure: go.Figure) -> list[list[str]]:
    """Return the vertical axes that traces use, by rows from the top down."""
    places: dict[str, tuple[float, float]] = {}
    for trace in figure.data:
        name, along = trace.yaxis or "y", _axis(figure, trace.xaxis or "x")
        top, left = (axis.domain or (0.0,) for axis in (_axis(figure, name), along))
        places.setdefault(name, (-top[0], left[0]))
    rows: dict[float, list[str]] = {}
    for name in sorted(places, key=lambda name: places[name]):
        rows.setdefault(places[name][0], []).append(name)
    return list(rows.values())


def _folded(grid: list[list[str]], width: int) -> list[list[str]]:
    """Return rows of one subplot each as fewer rows of several."""
    names = [name for row in grid for name in row]
    return [names[first : first + width] for first in range(0, len(names), width)]


def _titles(figure: go.Figure, row: Sequence[str]) -> set[str]:
    """Return the different titles of vertical axes; several quantities share no scale."""
    return {title for name in row if (title := _axis(figure, name).title.text)}


def _axis(figure: go.Figure, name: str) -> Any:
    return figure.layout[f"{name[0]}axis{name[1:]}"]


def _draw_row(figure: go.Figure, row: str, at: Axes) -> None:
    traces = [trace for trace in figure.data if (trace.yaxis or "y") == row]
    _draw_bars([trace for trace in traces if trace.type == "bar"], figure.layout.bargap, at)
    lines = [trace for trace in traces if trace.type != "bar"]
    places = {
        is_scatter: _marker_places(figure.data, is_scatter=is_scatter)
        if len(_marker_places(lines, is_scatter=is_scatter)) > 1 else {}
        for is_scatter in (False, True)
    }  # fmt: skip
    for before, trace in zip([None, *lines], lines, strict=False):
        of_kind = places[trace.mode == "markers"]
        _draw_line(trace, before, at, of_kind.get(_line_colour(trace), 0))
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
            title = _text(axis.title.text)
            quantity = figure.layout.meta if axis is across else None
            label(f"{quantity} ({title})" if quantity else title)
        if axis.tickvals is not None and axis.ticktext is not None:
            ticks = at.set_xticks if axis is along else at.set_yticks
            ticks(list(axis.tickvals), [_text(text) for text in axis.ticktext])
            (at.xaxis if axis is along else at.yaxis).minorticks_off()
    _draw_levels(figure, row, at, np.log10 if across.type == "log" else np.asarray)


def _line_colour(trace: Any) -> Any:
    own = trace.marker.color if isinstance(trace.marker.color, str) else None
    return _colour(trace.line.color or own)


def _marker_places(traces: Iterable[Any], *, is_scatter: bool) -> dict[Any, int]:
    """Return the place of the marker of each colour that named lines, or named points, have.

    A law's colour has the same marker in every figure; other colours follow in their order.
    """
    named = [each for each in traces if each.type != "bar" and each.name
             and (each.mode == "markers") is is_scatter]  # fmt: skip
    colours = dict.fromkeys(map(_line_colour, named))
    laws = [palette(number) for number in range(len(_OWN_MARKERS))]
    others = [colour for colour in colours if colour not in laws]
    return {
        colour: laws.index(colour) if colour in laws else others.index(colour) for colour in colours
    }


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
        at.bar([places[x] + off for x in trace.x], heights, width, label=_label(trace),
               color=colour, hatch=_HATCHES[number % len(_HATCHES)], edgecolor="white",
               linewidth=0.0)  # fmt: skip
        for x, height, text in zip(trace.x, heights, trace.text or (), strict=False):
            if text and not height:  # an empty place, unless it says why
                at.annotate(_text(text), (places[x] + off, 0.0), (0.0, 1.5), ha="center",
                            textcoords="offset points", va="bottom")  # fmt: skip
    if has_names:
        at.set_xticks(list(places.values()), [_text(name) for name in names])


def _draw_levels(figure: go.Figure, row: str, at: Axes, scale: Callable[[Any], Any]) -> None:
    """Draw lines across a whole row, such as a bound, unless they are far from all data."""
    low, high = scale(at.get_ylim())
    room = _FARTHEST_LEVEL * (high - low)
    for shape in figure.layout.shapes:
        style = {
            "color": _colour(shape.line.color), "linewidth": 0.6,
            "linestyle": _DASHES.get(shape.line.dash or "solid", "-"),
            "label": _text(shape.name if shape.showlegend else None),
        }  # fmt: skip
        if shape.type == "line" and shape.yref == row and shape.y0 == shape.y1:
            if low - room <= scale(shape.y0) <= high + room:
                at.axhline(shape.y0, **style)
        elif shape.type == "line" and shape.yref == f"{row} domain" and shape.x0 == shape.x1:
            left, right = at.get_xlim()
            if abs(shape.x0 - 0.5 * (left + right)) <= (0.5 + _FARTHEST_LEVEL) * (right - left):
                at.axvline(shape.x0, **style)


def _draw_line(trace: Any, before: Any, at: Axes, place: int) -> None:
    """Draw a line or markers, and the band between it and the trace before.

    Args:
        trace: the trace.
        before: the one before it; None for the first.
        at: where.
        place: of its colour among those of the figure, by which it has markers of its own.
    """
    mode = trace.mode or "lines"
    colour, is_thick = _line_colour(trace), (trace.line.width or 0.0) >= _THICK_PX
    symbols = trace.marker.symbol
    by_point = isinstance(symbols, list | tuple)
    style: dict[str, Any] = {"label": _label(trace), "color": colour}
    if trace.name == BOUNDS:  # on top of a line that swings across them
        style |= {"color": INK, "zorder": 3.0}
    if is_thick:
        style |= {"linewidth": _PT_OF_PX * trace.line.width, "solid_capstyle": "butt"}
    if trace.fill == "tonexty" and before is not None:
        at.fill_between(trace.x, before.y, trace.y, color=_colour(trace.fillcolor), linewidth=0)
    if mode == "lines" and trace.line.width == 0:  # the edge of a band
        return
    if by_point and "lines" not in mode:
        style["fillstyle"] = _FILLS[place % len(_FILLS)]
        for number, (x, y, symbol) in enumerate(zip(trace.x, trace.y, symbols, strict=True)):
            shown = style if number == 0 else {**style, "label": "_nolegend_"}
            at.plot([x], [y], linestyle="", marker=_MARKERS.get(symbol, "o"), **shown)
        return
    marker = _MARKERS.get(symbols, "o") if "markers" in mode else ""
    if mode == "markers" and symbols is None and place:
        marker = _SCATTER_MARKERS[place % len(_SCATTER_MARKERS)]
    if mode == "lines" and symbols is None and place and not is_thick:
        marker = _OWN_MARKERS[place]
    if mode == "lines+markers" and symbols in _ROUND:
        marker = _SCATTER_MARKERS[place % len(_SCATTER_MARKERS)]
        style["fillstyle"] = "none" if place or symbols == "circle-open" else "full"
    if trace.error_x.array is not None:
        lower = (
            trace.error_x.array if trace.error_x.arrayminus is None else trace.error_x.arrayminus
        )
        at.errorbar(trace.x, trace.y, xerr=[lower, trace.error_x.array], fmt="none",
                    ecolor=colour, elinewidth=0.6, capsize=1.5)  # fmt: skip
    count = 0 if trace.x is None else len(trace.x)
    every = 1 if "markers" in mode else max(1, count // _MARKED_POINTS)
    at.plot(
        trace.x, trace.y,
        linestyle=_DASHES.get(trace.line.dash or "solid", "-") if "lines" in mode else "",
        marker=marker, markevery=(min(place, every - 1), every),
        drawstyle="steps-post" if trace.line.shape == "hv" else "default", **style,
    )  # fmt: skip


def _label(trace: Any) -> str:
    return "_nolegend_" if trace.showlegend is False else _text(trace.name)


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

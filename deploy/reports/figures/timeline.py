"""Timeline of a run: modes, scheduled faults, times, deadlines.

Functions that draw give None where a run has nothing to draw.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np
import plotly.graph_objects as go

from bus_schema.arrays import Vector
from bus_schema.messages import topics
from bus_schema.messages.run_event import EventKind
from bus_schema.messages.topics import Role
from bus_schema.runtime.modes import Mode, mode_in
from deploy.judge.result.timing import times_us
from deploy.judge.run_data import RunData
from deploy.reports.figures import style
from deploy.reports.figures.several_runs import colour_of
from deploy.reports.runs.run_numbers import TIMES
from deploy.study.comparison.compared_runs import ComparedRuns

_ROLES = (Role.PLANT, Role.CONTROLLER)
_COLOURS = {
    Mode.IDLE: "#cbd2d9",
    Mode.READY: "#7fb5d6",
    Mode.TRACKING: "#009e73",
    Mode.STOPPING: "#e08e0b",
    Mode.FAULT: style.ALARM,
}
_MARKS = {EventKind.FAULT: ("x", style.ALARM), EventKind.LIMIT: ("triangle-down", style.INK)}
_HEIGHT_PX, _BELOW_PX = 240, 105
_LEAST_SHARE = 0.004
_OPACITY = 0.09
_LEAST_SHADE = 0.002
_PERCENTILES = (50.0, 90.0, 99.0, 99.9, 99.99, 99.999, 99.9999)
_CURVE_POINTS = 300
_BARS = 200

T = TypeVar("T")


def timeline(run: RunData) -> go.Figure | None:
    """The modes of both sides over time, with faults and first touches of a limit.

    What lasts an instant is drawn wide enough to be seen.
    """
    spans = [(role, *span) for role in _ROLES for span in mode_spans(run, role)]
    if not spans:
        return None
    end_s = max(span[3] for span in spans)
    figure = style.new_figure(_HEIGHT_PX, "time (s)", legend=True)
    for mode in reversed(Mode):
        own = [(role, start, end) for role, its, start, end in spans if its is mode]
        name = mode.name.lower()
        figure.add_bar(
            y=[str(role) for role, _, _ in own],
            base=[start for _, start, _ in own],
            x=[max(end - start, _LEAST_SHARE * end_s) for _, start, end in own],
            orientation="h", name=name, marker={"color": _COLOURS[mode], "line": {"width": 0}},
            hovertext=[f"{name} {start:.3f} s to {end:.3f} s" for _, start, end in own],
            hoverinfo="text",
        )  # fmt: skip
    for kind, (symbol, colour) in _MARKS.items():
        events = [event for event in run.events if event.kind == kind and event.source in _ROLES]
        if events:
            figure.add_scatter(
                x=[event.stamp_ns * 1e-9 for event in events],
                y=[event.source for event in events], mode="markers", name=str(kind),
                marker={"symbol": symbol, "size": 10, "color": colour,
                        "line": {"color": "white", "width": 1}},
                hovertext=[style.plain(event.detail) for event in events], hoverinfo="text+x",
            )  # fmt: skip
    figure.update_layout(
        barmode="overlay",
        bargap=0.35,
        margin={"b": _BELOW_PX},  # the legend takes two rows where a page is narrow
        legend={"yref": "container", "y": 0, "yanchor": "bottom", "traceorder": "reversed"},
    )
    figure.update_xaxes(range=[0.0, max(end_s, 1e-9) * 1.01])
    figure.update_yaxes(categoryorder="array", categoryarray=[str(role) for role in _ROLES])
    return figure


def mode_spans(run: RunData, role: Role) -> list[tuple[Mode, float, float]]:
    """Modes of a side, each with its start and end in s."""
    mode_events = [e for e in run.events if e.source == role and e.kind == EventKind.MODE]
    changes = [
        (mode, e.stamp_ns * 1e-9) for e in mode_events if (mode := mode_in(e.detail)) is not None
    ]
    ends = [start_s for _, start_s in changes[1:]]
    ends.append(max((event.stamp_ns * 1e-9 for event in run.events), default=0.0))
    return [(mode, start, end) for (mode, start), end in zip(changes, ends, strict=False)]


def with_faults(draw: Callable[[ComparedRuns], T]) -> Callable[[ComparedRuns], T]:
    """The figure over time that `draw` makes, with the scheduled faults of its runs as shades.

    Runs with different faults have no shades.
    """

    def shaded(runs: ComparedRuns) -> T:
        figure = draw(runs)
        faults = [run.data.setup.scenario.faults for run in runs.runs]
        if isinstance(figure, go.Figure) and all(each == faults[0] for each in faults):
            _shade(figure, runs.runs[0].data)
        return figure

    return shaded


def fault_spans_s(run: RunData) -> list[tuple[float, float]]:
    """Begin and end of every fault within the run; one of an instant is wide enough to be seen."""
    end_s = float(run.times_s(topics.PLANT_TRUTH).max(initial=-1.0))
    return [
        (fault.at_s, max(min(fault.end_ns * 1e-9, end_s), fault.at_s + _LEAST_SHADE * end_s))
        for fault in run.setup.scenario.faults
        if fault.at_s <= end_s
    ]


def _shade(figure: go.Figure, run: RunData) -> None:
    """Add the shades: one shape in each row, as Plotly takes its time for each of hundreds."""
    spans = fault_spans_s(run)
    if not spans:
        return
    outline = " ".join(f"M{start},0 L{start},1 L{end},1 L{end},0 Z" for start, end in spans)
    look = {
        "type": "path", "path": outline, "fillcolor": style.ALARM, "opacity": _OPACITY,
        "line": {"width": 0}, "layer": "below", "name": "scheduled faults",
    }  # fmt: skip
    axes = dict.fromkeys((trace.xaxis or "x", trace.yaxis or "y") for trace in figure.data)
    shades = [{**look, "xref": x, "yref": f"{y} domain"} for x, y in axes]
    figure.layout.shapes = [*figure.layout.shapes, *shades]


def times_of_run(run: RunData) -> go.Figure | None:
    """Every time of a run as a curve over its percentiles."""
    series = [(TIMES[key], values) for key, values in times_us(run).items() if len(values)]
    return _percentiles(
        [(name, values, style.palette(at)) for at, (name, values) in enumerate(series)], 460
    )


def time_of_runs(runs: ComparedRuns, key: str) -> go.Figure | None:
    """One time of every run as a curve over its percentiles; None where it is 0 in all."""
    series = [(run.law, times_us(run.data)[key], colour_of(runs, run.law)) for run in runs.runs]
    return _percentiles([each for each in series if each[1].any()], 380)


def _percentiles(series: Sequence[tuple[str, Vector, str]], height_px: float) -> go.Figure | None:
    """A line for each name, values and colour, over percentiles spaced by 1 / (1 − p)."""
    if not series:
        return None
    curves = [_curve(*each) for each in series]
    figure = style.new_figure(height_px, "percentile", "µs", curves, legend=True)
    longest = max(len(values) for _, values, _ in series)
    ticks = [p for p in _PERCENTILES if 1.0 / (1.0 - p / 100.0) <= 1.5 * longest]
    figure.update_xaxes(
        type="log",
        tickvals=[1.0 / (1.0 - p / 100.0) for p in ticks],
        ticktext=[f"{p:.6g} %" for p in ticks],
    )
    figure.update_yaxes(type="log", dtick=1, tickformat=",")
    return figure


def deadline_misses(run: RunData) -> go.Figure | None:
    """Ticks that missed their deadline or were skipped, over time; None if none did."""
    truth = run.tables[topics.PLANT_TRUTH.name]
    times_s = run.times_s(topics.PLANT_TRUTH)
    missed = (truth["deadline_met"] == 0) | (truth["timing.lateness_ns"] < 0)
    if not missed.any():
        return None
    edges = np.linspace(0.0, times_s[-1] + run.setup.grid.period_ns * 1e-9, _BARS + 1)
    misses, _ = np.histogram(times_s[missed], edges)
    ticks, _ = np.histogram(times_s, edges)
    percent = 100.0 * misses / np.maximum(ticks, 1)
    figure = style.new_figure(460, "time (s)", "missed ticks (%)")
    figure.add_bar(
        x=(edges[:-1] + edges[1:]) / 2, y=percent, customdata=misses,
        marker={"color": style.ALARM, "line": {"width": 0}},
        hovertemplate="%{x:.3g} s: %{customdata} ticks, %{y:.1f} %<extra></extra>",
    )  # fmt: skip
    figure.update_layout(bargap=0)
    figure.update_xaxes(range=[0.0, edges[-1]])
    figure.update_yaxes(rangemode="tozero")
    return figure


def _curve(name: str, values: Vector, colour: str) -> go.Scatter:
    """A time as a curve over its percentiles, spaced by 1 / (1 − p)."""
    one_in = np.geomspace(1.0, max(len(values), 2), _CURVE_POINTS)
    percentiles = 1.0 - 1.0 / one_in
    curve = np.quantile(values, percentiles, method="inverted_cdf")
    return go.Scatter(
        x=one_in, y=np.where(curve > 0.0, curve, np.nan), mode="lines",
        name=style.plain(name if curve[-1] > 0.0 else f"{name} (always 0)"),
        line={"color": colour, "width": 2, "shape": "hv"},
        customdata=100.0 * percentiles, hovertemplate="%{customdata:.5g} %: %{y:.4g} µs",
    )  # fmt: skip

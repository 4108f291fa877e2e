"""Delays and losses of the emulated link, beside those of the traces that it replays."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import plotly.graph_objects as go

from bus_schema.arrays import Vector
from bus_schema.messages import topics
from bus_schema.messages.run_event import EventKind
from bus_schema.messages.topics import Role
from deploy.judge.run_data import RunData
from deploy.reports.figures import style
from deploy.study.comparison.compared_runs import ComparedRuns
from plant_emulator.channel.trace import PERCENTS

_DASHES = {"did": ("channel", "solid"), "trace": ("trace", "dash")}
_HEIGHT_PX, _LOW_PX = 380, 240
_SAME_MS = 0.01
"""Delays that differ by less are the same to a reader."""


def trace_percentiles(run: RunData) -> go.Figure | None:
    """Percentiles of the delay in each direction with a trace; None where there is none."""
    lines = list(_lines(run, "percentiles_ms", list(PERCENTS)))
    if not lines:
        return None
    figure = style.new_figure(_HEIGHT_PX, "percentile", "delay (ms)", lines, legend=True)
    return figure.update_yaxes(rangemode="tozero")


def trace_autocorrelation(run: RunData) -> go.Figure | None:
    """Draw the autocorrelation of delays; None where there is no trace."""
    lines = list(_lines(run, "autocorrelation"))
    if not lines:
        return None
    figure = style.new_figure(_HEIGHT_PX, "lag (s)", "autocorrelation", lines, legend=True)
    return figure.update_xaxes(type="log")


def arrivals(run: RunData) -> tuple[Vector, Vector]:
    """Times in s, and how long after its state the last command of each tick arrived, in ms.

    Without an automatic play-out commands act when they arrive, or after a constant time.
    """
    field = "arrival_delay_ns" if run.setup.link.plays_automatically else "command_delay_ns"
    table = run.tables[topics.PLANT_STATUS.name]
    given = (table[field] > 0) & (table["command_sequence"] > 0)
    return run.times_s(topics.PLANT_STATUS)[given], 1e-6 * table[field][given]


def delay_over_time(runs: ComparedRuns) -> go.Figure | None:
    """Draw the delays at which commands arrived and acted, and the one in force at the loss.

    None where the delay was always the same.
    """
    run, lost_s = runs.runs[0].data, runs.runs[0].result.bounds.first_violation_s
    delays_ns = run.tables[topics.PLANT_STATUS.name]["command_delay_ns"]
    given = run.tables[topics.PLANT_STATUS.name]["command_sequence"] > 0
    times_s, delays_ms = run.times_s(topics.PLANT_STATUS)[given], 1e-6 * delays_ns[given]
    arrived_s, arrived_ms = arrivals(run)
    most = max((np.ptp(each) for each in (delays_ms, arrived_ms) if len(each)), default=0.0)
    if most < _SAME_MS:
        return None
    lines = [style.line(times_s, delays_ms, style.INK, "acts")]
    if run.setup.link.plays_automatically:
        lines += [
            style.line(arrived_s, arrived_ms, style.palette(0), "arrives, and waits until it acts")
        ]
    figure = style.new_figure(_LOW_PX, "time (s)", "after its state (ms)", lines)
    if lost_s is not None:
        at = max(0, int(np.searchsorted(times_s, lost_s, side="right")) - 1)
        figure.add_scatter(
            x=[lost_s], y=[delays_ms[at]], mode="markers", name="bounds left for the first time",
            marker={"color": style.palette(1), "size": 11, "symbol": "x"},
        )  # fmt: skip
    style.put_legend_on_top(figure, len(figure.data) - 1)
    return figure.update_yaxes(rangemode="tozero")


def _lines(run: RunData, key: str, places: list[float] | None = None) -> Iterator[go.Scatter]:
    counts = run.last_values(Role.PLANT, EventKind.COUNTS)
    for number, direction in enumerate(("uplink", "downlink")):
        curves = (counts.get(direction) or {}).get("curves", {})
        for name, (title, dash) in _DASHES.items():
            own = curves.get(name, {})
            if own.get(key):
                yield go.Scatter(
                    x=places or own.get("lags_s"), y=own[key], mode="lines",
                    name=f"{direction}, {title}",
                    line={"color": style.palette(number), "width": 2, "dash": dash},
                )  # fmt: skip

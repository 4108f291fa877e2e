"""What the emulated link did to messages, beside what the traces that it replays say."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import plotly.graph_objects as go

from bus_schema.messages import topics
from bus_schema.messages.run_event import EventKind
from bus_schema.messages.topics import Role
from deploy.judge.run_data import RunData
from deploy.reports.figures import style
from deploy.study.comparison.comparison import ComparedRuns
from plant_emulator.channel.trace import PERCENTS

_DASHES = {"did": ("channel", "solid"), "trace": ("trace", "dash")}
_HEIGHT_PX, _LOW_PX = 380, 240
_SAME_MS = 0.01
"""Delays that differ by less are the same to a reader."""
_PLAYOUT = (
    (topics.CONTROL_STATUS, "horizon_ns", "acts"),
    (topics.PLANT_STATUS, "arrival_delay_ns", "arrives, the last of a tick"),
)
"""Topic, field and name of the lines that show when commands act and arrive."""


def trace_percentiles(run: RunData) -> go.Figure | None:
    """Percentiles of the delay in each direction with a trace; None where there is none."""
    lines = list(_lines(run, "percentiles_ms", list(PERCENTS)))
    if not lines:
        return None
    figure = style.new_figure(_HEIGHT_PX, "percentile", "delay (ms)", lines, legend=True)
    return figure.update_yaxes(rangemode="tozero")


def trace_autocorrelation(run: RunData) -> go.Figure | None:
    """How far delays resemble those of later messages; None where there is no trace."""
    lines = list(_lines(run, "autocorrelation"))
    if not lines:
        return None
    figure = style.new_figure(_HEIGHT_PX, "lag (s)", "autocorrelation", lines, legend=True)
    return figure.update_xaxes(type="log")


def delay_over_time(runs: ComparedRuns) -> go.Figure | None:
    """How late each command in force was, and which one was in force when bounds were left.

    None where the delay was always the same and the bounds were kept.
    """
    run, lost_s = runs.runs[0].data, runs.runs[0].summary["bounds"]["first_violation_s"]
    delays_ns = run.tables[topics.PLANT_STATUS.name]["command_delay_ns"]
    given = run.tables[topics.PLANT_STATUS.name]["command_sequence"] > 0
    times_s, delays_ms = run.times_s(topics.PLANT_STATUS)[given], 1e-6 * delays_ns[given]
    if not len(times_s) or (lost_s is None and np.ptp(delays_ms) < _SAME_MS):
        return None
    line = style.line(times_s, delays_ms, style.INK, "command in force")
    figure = style.new_figure(_LOW_PX, "time (s)", "after its state (ms)", [line], legend=True)
    if lost_s is not None:
        at = max(0, int(np.searchsorted(times_s, lost_s, side="right")) - 1)
        figure.add_scatter(
            x=[lost_s], y=[delays_ms[at]], mode="markers", name="bounds left for the first time",
            marker={"color": style.palette(1), "size": 11, "symbol": "x"},
        )  # fmt: skip
    return figure.update_yaxes(rangemode="tozero")


def playout(run: RunData) -> go.Figure | None:
    """When commands arrived and when they acted, after their states; None if they did not say."""
    if not run.setup.link.plays_automatically:
        return None
    lines = []
    for number, (topic, field, name) in enumerate(_PLAYOUT):
        values_ns = run.tables[topic.name][field]
        given = values_ns > 0
        times_s, values_ms = run.times_s(topic)[given], 1e-6 * values_ns[given]
        lines.append(style.line(times_s, values_ms, style.palette(number), name))
    figure = style.new_figure(_HEIGHT_PX, "time (s)", "after the state (ms)", lines, legend=True)
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

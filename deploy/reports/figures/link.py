"""What the emulated link did to messages, beside what the traces that it replays say."""

from __future__ import annotations

from collections.abc import Iterator

import plotly.graph_objects as go

from bus_schema.messages.run_event import EventKind
from bus_schema.messages.topics import Role
from deploy.judge.run_data import RunData
from deploy.reports.figures import style
from plant_emulator.channel.trace import PERCENTS

_DASHES = {"did": ("channel", "solid"), "trace": ("trace", "dash")}
_HEIGHT_PX = 380


def trace_percentiles(run: RunData) -> go.Figure | None:
    """Percentiles of the delay in each direction with a trace; None where there is none."""
    figure = _figure(run, "percentiles_ms", list(PERCENTS))
    if figure is not None:
        figure.update_xaxes(title_text="percentile")
        figure.update_yaxes(title_text="delay (ms)", rangemode="tozero")
    return figure


def trace_autocorrelation(run: RunData) -> go.Figure | None:
    """How far delays resemble those of later messages; None where there is no trace."""
    figure = _figure(run, "autocorrelation", None)
    if figure is not None:
        figure.update_xaxes(title_text="lag (s)", type="log")
        figure.update_yaxes(title_text="autocorrelation")
    return figure


def _figure(run: RunData, key: str, places: list[float] | None) -> go.Figure | None:
    lines = list(_lines(run, key, places))
    if not lines:
        return None
    figure = go.Figure(lines)
    style.apply(figure, _HEIGHT_PX, legend=True)
    return figure


def _lines(run: RunData, key: str, places: list[float] | None) -> Iterator[go.Scatter]:
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

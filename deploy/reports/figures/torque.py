"""Figures of what several laws ask of the actuators.

Every function gives None where a comparison has nothing to draw.
"""

from __future__ import annotations

import html

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from bus_schema.arrays import Matrix
from bus_schema.messages import topics
from deploy.comparison.comparison import Comparison, LawRun
from deploy.reports.figures.comparison import add_law, joint_bars, law_rows
from deploy.reports.figures.decimation import decimate
from deploy.reports.figures.style import INK, MUTED, joint_colour, style
from deploy.runs.chattering import CHATTER_HZ, power_spectrum

_TORQUE_POINTS = 1500
_ROW_PX = 150
_SPECTRUM_FLOOR = 1e-12


def torques(comparison: Comparison) -> go.Figure | None:
    """Commanded torques: a row per joint, a column per law, one scale along each row."""
    runs = [run for run in comparison.drawn if len(_efforts(run)) > 1]
    if not runs:
        return None
    names = runs[0].data.setup.robot.joint_names
    figure = make_subplots(
        rows=len(names), cols=len(runs), shared_xaxes=True, shared_yaxes="rows",
        column_titles=[html.escape(run.law) for run in runs],
        horizontal_spacing=0.012, vertical_spacing=0.06 / max(1, len(names) / 3),
    )  # fmt: skip
    for column, run in enumerate(runs, start=1):
        colour = joint_colour(comparison.colour_index(run.law))
        times_s = run.data.times_s(topics.JOINT_COMMANDS)
        for joint, effort in enumerate(_efforts(run).T, start=1):
            x, y = decimate(times_s, effort, _TORQUE_POINTS)
            figure.add_trace(
                go.Scatter(x=x, y=y, mode="lines", line={"color": colour, "width": 1}),
                row=joint, col=column,
            )  # fmt: skip
    style(figure, len(names) * _ROW_PX + 120)
    figure.update_layout(margin={"t": 64, "l": 84})
    figure.update_annotations(font={"size": 13, "color": INK})
    figure.update_xaxes(title_text="time (s)", row=len(names))
    for joint, name in enumerate(names, start=1):
        title = {"text": f"{html.escape(name)}<br>(N m)", "font": {"size": 11}}
        figure.update_yaxes(title=title, row=joint, col=1)
    return figure


def torque_spectra(comparison: Comparison) -> go.Figure | None:
    """Amplitude of the torques by frequency; from the dotted line on it counts as chatter."""
    runs = [run for run in comparison.drawn if len(_efforts(run)) > 1]
    if not runs:
        return None
    names = runs[0].data.setup.robot.joint_names
    figure = law_rows(names, "N m")
    for run in reversed(runs):
        rate_hz = run.data.setup.scenario.rate_hz
        frequencies, power = power_spectrum(_efforts(run), rate_hz)
        for joint, values in enumerate(power.T):
            amplitude = np.sqrt(2.0 * np.maximum(values, _SPECTRUM_FLOOR))
            add_law(figure, comparison, run.law, joint + 1, frequencies[1:], amplitude[1:])
    figure.update_xaxes(type="log", dtick=1, title_text="")
    figure.update_xaxes(title_text="frequency (Hz)", row=len(names))
    figure.update_yaxes(type="log", dtick=2, tickformat="~g")
    for joint in range(len(names)):
        dotted = {"color": MUTED, "width": 1, "dash": "dot"}
        figure.add_vline(CHATTER_HZ, row=joint + 1, line=dotted)
    return figure


def total_variation(comparison: Comparison) -> go.Figure | None:
    """Total variation of every joint's torque under every law."""
    return joint_bars(comparison, "torque", "total_variation_nm_per_s", "Σ|Δτ| (N m/s)")


def chatter_share(comparison: Comparison) -> go.Figure | None:
    """Share of every joint's torque energy that lies above 50 Hz, under every law."""
    return joint_bars(comparison, "torque", "share_above_50_hz", "energy above 50 Hz (%)", 100.0)


def _efforts(run: LawRun) -> Matrix:
    return np.asarray(run.data.tables[topics.JOINT_COMMANDS.name]["effort"])

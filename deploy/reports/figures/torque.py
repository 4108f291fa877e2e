"""Figures of what is asked of the actuators, by one law or by several.

Every function gives None where there is nothing to draw.
"""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from bus_schema.arrays import Matrix
from bus_schema.messages import topics
from deploy.comparison.comparison import Comparison, LawRun
from deploy.reports.figures import style
from deploy.reports.figures.decimation import decimate
from deploy.reports.figures.laws import add_law, law_colour, with_law_legend
from deploy.runs.judging.chattering import CHATTER_HZ, power_spectrum
from deploy.runs.judging.known_ticks import rows_after_gaps
from deploy.runs.run_data import RunData

_TORQUE_POINTS = 1500
_ROW_PX = 150
_SPECTRUM_FLOOR = 1e-12
_NEAR = 0.8


def torques(run: RunData) -> go.Figure | None:
    """Commanded torque of every joint, with its limits where it comes near them."""
    figure = style.joint_series(run, topics.JOINT_COMMANDS, "effort", "N m")
    if figure is None:
        return None
    peaks = np.abs(style.per_joint(run, topics.JOINT_COMMANDS, "effort")).max(axis=0)
    for joint, limit in enumerate(run.setup.robot.effort_limits_nm):
        if peaks[joint] > _NEAR * limit:
            for level in (-limit, limit):
                figure.add_hline(level, row=joint + 1, line=style.DOTTED)
    return figure


def torques_by_law(comparison: Comparison) -> go.Figure | None:
    """Commanded torques: a row per joint, a column per law, one scale along each row."""
    runs = _with_torques(comparison)
    if not runs:
        return None
    names = runs[0].data.setup.robot.joint_names
    figure = make_subplots(
        rows=len(names), cols=len(runs), shared_xaxes=True, shared_yaxes="rows",
        column_titles=[style.plain(run.law) for run in runs],
        horizontal_spacing=0.012, vertical_spacing=0.06 / max(1, len(names) / 3),
    )  # fmt: skip
    for column, run in enumerate(runs, start=1):
        stroke = {"color": law_colour(comparison, run.law), "width": 1}
        times_s = run.data.times_s(topics.JOINT_COMMANDS)
        for row, effort in enumerate(_efforts(run).T, start=1):
            x, y = decimate(times_s, effort, _TORQUE_POINTS)
            figure.add_scatter(x=x, y=y, mode="lines", line=stroke, row=row, col=column)
    style.apply(figure, len(names) * _ROW_PX + 120)
    figure.update_layout(margin={"t": 64, "l": 84})
    figure.update_annotations(font={"size": 13, "color": style.INK})
    figure.update_xaxes(title_text="time (s)", row=len(names))
    for row, name in enumerate(names, start=1):
        title = {"text": f"{style.plain(name)}<br>(N m)", "font": {"size": 11}}
        figure.update_yaxes(title=title, row=row, col=1)
    return figure


def torque_spectra(comparison: Comparison) -> go.Figure | None:
    """Amplitude of the torques by frequency; from the dotted line on it counts as chatter."""
    runs = _with_torques(comparison)
    if not runs:
        return None
    names = runs[0].data.setup.robot.joint_names
    figure = with_law_legend(style.joint_rows(names, "N m"))
    for run in reversed(runs):
        after_gaps = rows_after_gaps(run.data, run.data.times_s(topics.JOINT_COMMANDS))
        rate_hz = run.data.setup.scenario.rate_hz
        frequencies, power = power_spectrum(_efforts(run), rate_hz, after_gaps)
        amplitudes = np.sqrt(2.0 * np.maximum(power[1:], _SPECTRUM_FLOOR))
        add_law(figure, comparison, run.law, frequencies[1:], amplitudes.T)
    figure.update_xaxes(type="log", dtick=1, title_text="")
    figure.update_xaxes(title_text="frequency (Hz)", row=len(names))
    style.log_axis(figure)
    figure.add_vline(CHATTER_HZ, row="all", line=style.DOTTED)
    return figure


def _with_torques(comparison: Comparison) -> list[LawRun]:
    return [run for run in comparison.drawn if len(_efforts(run)) > 1]


def _efforts(run: LawRun) -> Matrix:
    return style.per_joint(run.data, topics.JOINT_COMMANDS, "effort")

"""Figures of joints: errors inside their bounds and torques, of one run or of several.

Every function gives None where there is nothing to draw.
"""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from bus_schema.arrays import Vector
from bus_schema.messages import topics
from deploy.judge.bounds import bound_usage
from deploy.judge.findings.chattering import CHATTER_HZ, power_spectrum
from deploy.judge.motion.torques import torques as judged_torques
from deploy.judge.run_data import RunData
from deploy.reports.figures import style
from deploy.reports.figures.several_runs import (
    add_envelopes,
    add_run,
    colour_of,
    group_of,
    with_runs,
)
from deploy.run.execute import JudgedRun
from deploy.scenario.setup import Setup
from deploy.study.comparison.compared_runs import ComparedRuns
from deploy.study.comparison.recorded import ticks_in_common

_TRUTH = topics.PLANT_TRUTH
_ZOOM_S = 1.0
_BAND_POINTS = 600
_HEADROOM = 1.6
_STRIP_PARTS = 400
"""Of a run: what is outside its bounds for less is drawn as long as that."""
_TORQUE_POINTS = 1500
_ROW_PX, _FIRST_SCREEN_PX = 150, 560
_SPECTRUM_FLOOR = 1e-12
_NEAR = 0.8


def error_in_funnel(runs: ComparedRuns) -> go.Figure | None:
    """True error of every joint inside its bounds, scaled to the bounds' steady state."""
    figure = _errors(runs, np.inf)
    if figure is None:
        return None
    run = runs.drawn[0].data
    limits = _HEADROOM * run.setup.funnel.final_rad
    late = run.times_s(_TRUTH) >= run.setup.scenario.metrics.from_s
    if len(runs.runs) == 1 and late.any():
        limits = np.maximum(limits, 1.1 * np.abs(run.true_errors_rad[late]).max(axis=0))
    if len(runs.runs) == 1:
        figure.update_layout(height=min(figure.layout.height, _FIRST_SCREEN_PX))
    return _scaled(figure, runs, style.MRAD * limits, np.inf)


def error_first_second(runs: ComparedRuns) -> go.Figure | None:
    """True error of every joint inside its bounds, at the start of the run."""
    figure = _errors(runs, _ZOOM_S)
    if figure is None or len(runs.runs) > 1:
        return figure
    largest = {trace.yaxis: 0.0 for trace in figure.data}
    for trace in figure.data:
        largest[trace.yaxis] = max(largest[trace.yaxis], float(np.abs(trace.y).max()))
    return _scaled(figure, runs, 1.05 * np.array([*largest.values()]), _ZOOM_S)


def transformed_error(run: RunData) -> go.Figure | None:
    """Transformed error ε of every joint."""
    return style.joint_series(run, topics.CONTROL_STATUS, "transformed_error", "ε")


def error_envelopes(runs: ComparedRuns) -> go.Figure | None:
    """Size of the true error of every joint on a logarithmic scale, with its steady bound."""
    if not runs.drawn:
        return None
    setup = runs.drawn[0].data.setup
    rows = style.joint_rows(setup.robot.joint_names, "mrad", "largest |error|")
    figure = with_runs(rows, runs) if len(runs.runs) > 1 else rows
    for run in runs.drawn:
        errors = style.MRAD * run.data.true_errors_rad
        add_envelopes(figure, runs, run.law, run.data.times_s(_TRUTH), errors)
    if len(runs.runs) == 1:
        for joint, drawn in enumerate(figure.data):
            drawn.line.color = style.palette(joint)
    for joint, final in enumerate(style.MRAD * setup.funnel.final_rad):
        figure.add_hline(float(final), row=joint + 1, line=style.DOTTED)
    return figure


def positions_apart(runs: ComparedRuns) -> go.Figure | None:
    """Return the distance of each run's positions from those of the first, at the same instant."""
    first = runs.runs[0].data
    own = first.tables[_TRUTH.name]["position"]
    figure = with_runs(style.joint_rows(first.setup.robot.joint_names, "mrad", "distance"), runs)
    for run in runs.drawn:
        theirs = run.data.tables[_TRUTH.name]["position"]
        here, there = ticks_in_common(first, run.data)
        apart = style.MRAD * (theirs[there] - own[here])
        if run is not runs.runs[0] and len(here) > 1 and apart.any():
            add_envelopes(figure, runs, run.law, first.times_s(_TRUTH)[here], apart)
    return figure if figure.data else None


def _errors(runs: ComparedRuns, until_s: float) -> go.Figure | None:
    if not runs.drawn:
        return None
    end_s = max(run.data.times_s(_TRUTH)[-1] for run in runs.drawn)
    figure = _bounds(runs.drawn[0].data.setup, min(until_s, end_s))
    if len(runs.runs) == 1:
        _add_error(figure, runs.drawn[0].data, until_s)
        return figure
    figure.update_traces(showlegend=False, hoverinfo="skip")
    with_runs(figure, runs)
    for run in reversed(runs.drawn):  # the first run lies on top
        times_s = run.data.times_s(_TRUTH)
        shown = times_s <= until_s
        errors = style.MRAD * run.data.true_errors_rad[shown]
        add_run(figure, runs, run.law, times_s[shown], errors.T)
    return figure


def _add_error(figure: go.Figure, run: RunData, until_s: float) -> None:
    """The error of a run that stands alone."""
    times_s = run.times_s(_TRUTH)
    shown = times_s <= until_s
    errors = style.MRAD * run.true_errors_rad[shown]
    for joint, error in enumerate(errors.T):
        trace = style.line(times_s[shown], error, style.palette(joint), "true error")
        figure.add_trace(trace, row=joint + 1, col=1)


def _scaled(figure: go.Figure, runs: ComparedRuns, limits: Vector, until_s: float) -> go.Figure:
    """Give each row its limits; below a run that stands alone, mark the times outside the bounds.

    The mark is a strip along the lower edge: marks on the line would hide it.
    """
    for row, limit in enumerate(limits.tolist(), start=1):
        figure.update_yaxes(range=[-limit, limit], row=row)
    if len(runs.runs) > 1:
        return figure
    run = runs.drawn[0].data
    times_s = run.times_s(_TRUTH)
    shown = times_s <= until_s
    part_s = max(times_s[shown][-1] / _STRIP_PARTS, 1e-9 * run.setup.grid.period_ns)
    for row, out in enumerate((bound_usage(run)[shown] >= 1.0).T, start=1):
        parts = np.unique(times_s[shown][out] // part_s)
        if len(parts):
            stretches = np.split(parts, np.flatnonzero(np.diff(parts) > 1.0) + 1)
            begins, ends = np.array([(each[0], each[-1] + 1.0) for each in stretches]).T
            x = style.apart(part_s * begins, part_s * ends)
            figure.add_scatter(
                x=x, y=np.full(len(x), -limits[row - 1]), name="outside the bounds", mode="lines",
                line={"color": style.ALARM, "width": 8}, hoverinfo="name+x", row=row, col=1,
            )  # fmt: skip
    return figure


def _bounds(setup: Setup, until_s: float) -> go.Figure:
    """A row per joint, with its bounds as a shaded band."""
    times_s: Vector = np.linspace(0.0, until_s, _BAND_POINTS)
    figure = style.joint_rows(setup.robot.joint_names, "mrad", "true error")
    upper, lower = (style.MRAD * bound.T for bound in setup.funnel.bounds(times_s))
    for joint in range(setup.robot.joints):
        figure.add_traces(style.band(times_s, upper[joint], lower[joint]), rows=joint + 1, cols=1)
    figure.update_xaxes(range=[0.0, until_s])
    return figure


def torques(run: RunData) -> go.Figure | None:
    """Torque of every joint as it is judged, with its limits where it comes near them."""
    times_s, values_nm, _ = judged_torques(run)
    if not np.isfinite(values_nm).any():
        return None
    figure = style.joint_rows(names := run.setup.robot.joint_names, "N m", "torque")
    for row, (name, value) in enumerate(zip(names, values_nm.T, strict=True), start=1):
        figure.add_trace(style.line(times_s, value, style.palette(row - 1), name), row=row, col=1)
    peaks = np.abs(values_nm).max(axis=0)
    for joint, limit in enumerate(run.setup.robot.effort_limits_nm):
        if peaks[joint] > _NEAR * limit:
            for level in (-limit, limit):
                figure.add_hline(level, row=joint + 1, line=style.DOTTED)
    return figure


def torques_side_by_side(runs: ComparedRuns) -> go.Figure | None:
    """Judged torques: a row per joint, a column per run, one scale along each row."""
    shown = _with_torques(runs)
    if not shown:
        return None
    names = shown[0].data.setup.robot.joint_names
    figure = make_subplots(
        rows=len(names), cols=len(shown), shared_xaxes=True, shared_yaxes="rows",
        horizontal_spacing=0.012, vertical_spacing=0.06 / max(1, len(names) / 3),
        figure=style.new_figure(len(names) * _ROW_PX + 90),
    )  # fmt: skip
    for column, run in enumerate(shown, start=1):
        stroke = {"color": colour_of(runs, run.law), "width": 1}
        times_s, values_nm, _ = judged_torques(run.data)
        for row, effort in enumerate(values_nm.T, start=1):
            x, y = style.decimate(times_s, effort, _TORQUE_POINTS)
            figure.add_scatter(
                x=x, y=y, mode="lines", line=stroke, row=row, col=column,
                name=style.plain(run.law), legendgroup=group_of(runs, run.law), showlegend=row == 1,
            )  # fmt: skip
    figure.update_layout(margin={"l": 84})
    style.add_legend(figure, [run.law for run in shown])
    figure.update_xaxes(title_text="time (s)", row=len(names))
    for row, name in enumerate(names, start=1):
        title = {"text": f"{style.plain(name)}<br>(N m)", "font": {"size": 11}}
        figure.update_yaxes(title=title, row=row, col=1)
    return figure


def torque_spectra(runs: ComparedRuns) -> go.Figure | None:
    """Amplitude of the torques by frequency; from the dotted line on it counts as chatter."""
    shown = _with_torques(runs)
    if not shown:
        return None
    names = shown[0].data.setup.robot.joint_names
    figure = with_runs(style.joint_rows(names, "N m", "amplitude"), runs)
    for run in reversed(shown):
        _, values_nm, after_gaps = judged_torques(run.data)
        rate_hz = run.data.setup.scenario.rate_hz
        frequencies, power = power_spectrum(values_nm, rate_hz, after_gaps)
        amplitudes = np.sqrt(2.0 * np.maximum(power[1:], _SPECTRUM_FLOOR))
        add_run(figure, runs, run.law, frequencies[1:], amplitudes.T)
    figure.update_xaxes(type="log", dtick=1, title_text="")
    figure.update_xaxes(title_text="frequency (Hz)", row=len(names))
    style.log_axis(figure)
    figure.add_vline(CHATTER_HZ, row="all", line=style.DOTTED)
    return figure


def _with_torques(runs: ComparedRuns) -> list[JudgedRun]:
    return [run for run in runs.drawn if len(judged_torques(run.data).times_s) > 1]

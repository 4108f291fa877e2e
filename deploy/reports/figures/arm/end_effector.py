"""Figures of the end effector: its path and its error, of one run or of several laws.

Every function gives None where there is nothing to draw.
"""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from bus_schema.arrays import Matrix, Vector
from bus_schema.messages import topics
from controller.manipulator_model import ManipulatorModel
from controller.reference import sample_positions
from deploy.comparison.comparison import Comparison
from deploy.reports.figures import style
from deploy.reports.figures.arm.space import still_space
from deploy.reports.figures.laws import add_envelopes, law_colour, with_law_legend
from deploy.runs.run_data import RunData, stamps_s

_HEIGHT_PX = 480
_POINTS = 2000
_HEADROOM = 1.6


def tip_path(run: RunData) -> go.Figure | None:
    """Path of the tip and path asked for, in the base frame."""
    _, actual, wanted = tip_positions(run)
    if not len(actual):
        return None
    figure = go.Figure([
        _path(wanted, "reference", style.MUTED, 9),
        _path(actual, "true", style.palette(0), 4),
        _mark(actual[0], "start", "circle"),
        _mark(actual[-1], "end", "diamond"),
    ])  # fmt: skip
    _style_path(figure, _HEIGHT_PX)
    return figure


def tip_error(run: RunData) -> go.Figure | None:
    """True error of the tip along each axis of the base frame, scaled to its later part."""
    times_s, actual, wanted = tip_positions(run)
    if not len(times_s):
        return None
    errors = style.MM * (actual - wanted)
    figure = go.Figure([
        style.line(times_s, error, style.palette(index), axis)
        for index, (axis, error) in enumerate(zip("xyz", errors.T, strict=True))
    ])  # fmt: skip
    style.apply(figure, _HEIGHT_PX, legend=True)
    figure.update_xaxes(title_text="time (s)")
    figure.update_yaxes(title_text="mm")
    late = times_s >= run.setup.scenario.metrics.from_s
    if late.any():
        limit = _HEADROOM * max(np.abs(errors[late]).max(), 1e-6)
        figure.update_yaxes(range=[-limit, limit])
    return figure


def tip_paths(comparison: Comparison) -> go.Figure | None:
    """Path of the tip under every law, and the path asked for."""
    figure = go.Figure()
    for run in comparison.drawn:
        _, actual, wanted = tip_positions(run.data)
        if not figure.data:
            reference = _path(wanted, "reference", "#c3cad1", 12)
            figure.add_traces([reference, _mark(actual[0], "start", "circle")])
        figure.add_trace(_path(actual, run.law, law_colour(comparison, run.law), 4))
    if not figure.data:
        return None
    _style_path(figure, 560)
    return figure


def tip_error_envelopes(comparison: Comparison) -> go.Figure | None:
    """Size of the tip's error along each axis of the base frame, on a logarithmic scale."""
    if not comparison.drawn:
        return None
    figure = with_law_legend(style.joint_rows(("x", "y", "z"), "mm"))
    for run in comparison.drawn:
        times_s, actual, wanted = tip_positions(run.data)
        add_envelopes(figure, comparison, run.law, times_s, style.MM * (actual - wanted))
    return figure


def tip_positions(run: RunData) -> tuple[Vector, Matrix, Matrix]:
    """Evenly spaced times (s), with the true and the reference position of the tip (m) at each."""
    truth = run.tables[topics.PLANT_TRUTH.name]
    truth = truth[:: max(1, len(truth) // _POINTS)]
    times_s, model = stamps_s(truth), ManipulatorModel(run.setup.robot)
    wanted = sample_positions(run.setup.reference, times_s, run.setup.robot.joints)
    actual, reference = (
        np.array([model.tip_position(position) for position in positions])
        for positions in (truth["position"], wanted)
    )
    return times_s, actual, reference


def _path(points: Matrix, name: str, colour: str, width: float) -> go.Scatter3d:
    """A path in space; points have shape (points, 3), m."""
    x, y, z = points.T
    stroke = {"color": colour, "width": width}
    return go.Scatter3d(x=x, y=y, z=z, name=style.plain(name), mode="lines", line=stroke)


def _mark(point: Vector, name: str, symbol: str) -> go.Scatter3d:
    """A point in space, shape (3,), m."""
    x, y, z = point
    marker = {"size": 5, "color": style.INK, "symbol": symbol}
    return go.Scatter3d(x=[x], y=[y], z=[z], name=name, mode="markers", marker=marker)


def _style_path(figure: go.Figure, height_px: float) -> None:
    style.apply(figure, height_px, legend=True)
    points = np.hstack([[trace.x, trace.y, trace.z] for trace in figure.data]).T
    figure.update_layout(
        scene=still_space(points),
        margin={"l": 0, "r": 0, "b": 0},
        legend={"y": 0},
    )

"""The arm and its tip in space: scenes that stand still, a moving skeleton, the tip's error.

Functions that draw a whole figure give None where there is nothing to draw.
"""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.messages import topics
from controller.manipulator_model import ManipulatorModel
from controller.reference import sample_positions
from deploy.judge.run_data import RunData, stamps_s
from deploy.reports.figures import style
from deploy.reports.figures.several_runs import add_envelopes, colour_of, with_runs
from deploy.reports.page import Motion
from deploy.study.comparison.compared_runs import ComparedRuns

_FRAMES = 400
_POINTS = 2000
_HEADROOM = 1.6
_HEIGHT_PX = 480
_MARK = {"size": 5, "color": style.INK}
_AXES = (style.INK, "#9aa5b1", style.INK)
"""Colours that no joint has."""
_GHOST = {"color": style.MUTED, "width": 18}
_ROOM = 0.05
"""On every side, as a share of the longest one."""
_CAMERA = {"eye": {"x": 1.86, "y": 1.61, "z": 0.74}, "center": {"x": 0, "y": 0, "z": -0.12}}
"""It looks through 45° at all of a box with the diagonal of a cube of side 1, of any form, a
little below its middle: most ticks and titles are at its foot."""


def show_in_space(figure: go.Figure, points: NDArray[np.float64], **more: object) -> None:
    """Give a figure a scene of one scale along all axes, and nothing around it.

    Left to itself, the scale would follow what is shown at the instant.

    Args:
        figure: the figure.
        points: all that the scene has to hold, shape (..., 3), m; NaN where there is none.
        more: what else the scene has.
    """
    flat = points.reshape(-1, 3)
    lower, upper = np.nanmin(flat, axis=0), np.nanmax(flat, axis=0)
    room = _ROOM * max(float((upper - lower).max()), 1e-3)
    lower, upper = lower - room, upper + room
    spans = upper - lower
    sides = spans / np.sqrt(np.mean(spans**2))  # as large as a cube, of any form
    axes = {
        f"{name}axis": {"title": {"text": f"{name} (m)"}, "nticks": 6, "range": [low, high]}
        for name, low, high in zip("xyz", lower.tolist(), upper.tolist(), strict=True)
    }
    ratio = dict(zip("xyz", sides.tolist(), strict=True))
    scene = {"aspectmode": "manual", "aspectratio": ratio, "camera": _CAMERA, **axes, **more}
    figure.update_layout(scene=scene, margin={"l": 0, "r": 0, "b": 0}, legend={"y": 0})


def arm_motion(run: RunData) -> Motion | None:
    """The arm from joint to joint as it moved, before a ghost of it on the reference.

    None if nothing was recorded.
    """
    truth = run.tables[topics.PLANT_TRUTH.name]
    if not len(truth):
        return None
    shown = np.unique(np.linspace(0, len(truth) - 1, _FRAMES).round().astype(int))
    times_s, robot = stamps_s(truth[shown]), run.setup.robot
    wanted = sample_positions(run.setup.reference, times_s, robot.joints)
    model = ManipulatorModel(robot)
    ghost, arm = (skeletons(model, each) for each in (wanted, truth["position"][shown]))
    traces = [
        _in_space(ghost[0], "reference", "lines", line=_GHOST, opacity=0.35, hoverinfo="skip"),
        _in_space(arm[0], "true", "lines+markers", line={"color": style.INK, "width": 7},
                  marker={"size": 4, "color": style.INK}, hoverinfo="skip"),
    ]  # fmt: skip
    figure = style.new_figure(_HEIGHT_PX, traces=traces, legend=True)
    show_in_space(figure, np.concatenate([ghost, arm]))
    return Motion(figure, times_s, np.stack([ghost, arm], axis=1))


def skeletons(model: ManipulatorModel, positions: Matrix) -> NDArray[np.float64]:
    """Bones of the arm in each posture as one broken line each, shape (postures, points, 3), m.

    NaN follows each bone, the last of which ends at the tip.
    """
    bones = np.array([model.skeleton(position) for position in positions])
    gaps = np.full_like(bones[:, :, :1], np.nan)
    return np.concatenate([bones, gaps], axis=2).reshape(len(bones), -1, 3)


def _in_space(points: Matrix, name: str, mode: str, **look: object) -> go.Scatter3d:
    """A trace in space; points have shape (points, 3), m."""
    x, y, z = points.T
    return go.Scatter3d(x=x, y=y, z=z, name=style.plain(name), mode=mode, **look)


def tip_path(runs: ComparedRuns) -> go.Figure | None:
    """Path of the tip in every run, and the path asked for, in the base frame."""
    is_alone = len(runs.runs) == 1
    colour, width = (style.MUTED, 9) if is_alone else ("#c3cad1", 12)
    reference = {"color": colour, "width": width}
    figure = style.new_figure(_HEIGHT_PX if is_alone else 560, legend=True)
    for run in runs.drawn:
        _, actual, wanted = tip_positions(run.data)
        if not figure.data:
            figure.add_trace(_in_space(wanted, "reference", "lines", line=reference))
            start = {**_MARK, "symbol": "circle"}
            figure.add_trace(_in_space(actual[:1], "start", "markers", marker=start))
        stroke = {"color": style.INK if is_alone else colour_of(runs, run.law), "width": 4}
        name = "true" if is_alone else run.law
        figure.add_trace(_in_space(actual, name, "lines", line=stroke))
        if is_alone:
            end = {**_MARK, "symbol": "diamond"}
            figure.add_trace(_in_space(actual[-1:], "end", "markers", marker=end))
    if not figure.data:
        return None
    points = np.hstack([[trace.x, trace.y, trace.z] for trace in figure.data]).T
    show_in_space(figure, points)
    return figure


def tip_error(run: RunData) -> go.Figure | None:
    """True error of the tip along each axis of the base frame, scaled to its later part."""
    times_s, actual, wanted = tip_positions(run)
    if not len(times_s):
        return None
    errors = style.MM * (actual - wanted)
    traces = [
        style.line(times_s, error, colour, axis)
        for colour, axis, error in zip(_AXES, "xyz", errors.T, strict=True)
    ]
    traces[2].line.dash = "dot"
    figure = style.new_figure(_HEIGHT_PX, "time (s)", "mm", traces, legend=True)
    late = times_s >= run.setup.scenario.metrics.from_s
    if late.any():
        limit = _HEADROOM * max(np.abs(errors[late]).max(), 1e-6)
        figure.update_yaxes(range=[-limit, limit])
    return figure


def tip_error_envelopes(runs: ComparedRuns) -> go.Figure | None:
    """Size of the tip's error along each axis of the base frame, on a logarithmic scale."""
    if not runs.drawn:
        return None
    figure = with_runs(style.joint_rows(("x", "y", "z"), "mm"), runs)
    for run in runs.drawn:
        times_s, actual, wanted = tip_positions(run.data)
        add_envelopes(figure, runs, run.law, times_s, style.MM * (actual - wanted))
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

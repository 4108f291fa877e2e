"""Figures of what the arm did: errors, torques, path and what the network learned.

Every function gives None where a run has nothing to draw.
"""

from __future__ import annotations

import html

import numpy as np
import plotly.graph_objects as go

from bus_schema.arrays import Matrix, Vector
from bus_schema.messages import topics
from bus_schema.messages.topics import Topic
from controller.manipulator_model import ManipulatorModel
from controller.reference import sample_positions
from deploy.reports.figures.style import (
    ALARM,
    INK,
    MUTED,
    band,
    joint_colour,
    joint_rows,
    line,
    style,
)
from deploy.runs.metrics import bound_usage
from deploy.runs.run_data import RunData, stamps_s

_MRAD = _MM = 1e3
_ZOOM_S = 1.0
_BAND_POINTS = 600
_PATH_CAMERA = {"eye": {"x": 1.8, "y": 1.55, "z": 0.9}, "center": {"x": 0, "y": 0, "z": -0.12}}
_PATH_PX = 480
_PATH_POINTS = 2000
_HEADROOM = 1.6


def error_in_funnel(run: RunData) -> go.Figure | None:
    """True error of every joint inside its bounds, scaled to the bounds' steady state."""
    figure = _errors(run, np.inf)
    if figure is None:
        return None
    late = run.times_s(topics.PLANT_TRUTH) >= run.setup.scenario.metrics.from_s
    if late.any():
        largest = np.abs(run.true_errors_rad[late]).max(axis=0)
        reach = _MRAD * np.maximum(_HEADROOM * run.setup.funnel.final_rad, 1.1 * largest)
        for joint, limit in enumerate(reach):
            figure.update_yaxes(range=[-limit, limit], row=joint + 1)
    return figure


def error_first_second(run: RunData) -> go.Figure | None:
    """True error of every joint inside its bounds, at the start of the run."""
    return _errors(run, _ZOOM_S)


def transformed_error(run: RunData) -> go.Figure | None:
    """Transformed error ε of every joint."""
    return _joint_series(run, topics.CONTROL_STATUS, "transformed_error", "ε")


def torques(run: RunData) -> go.Figure | None:
    """Commanded torque of every joint, with its limits where it comes near them."""
    figure = _joint_series(run, topics.JOINT_COMMANDS, "effort", "N m")
    if figure is None:
        return None
    peaks = np.abs(_per_joint(run, topics.JOINT_COMMANDS, "effort")).max(axis=0)
    for joint, limit in enumerate(run.setup.robot.effort_limits_nm):
        if peaks[joint] > 0.8 * limit:
            for level in (-limit, limit):
                figure.add_hline(
                    level, row=joint + 1, line={"color": MUTED, "width": 1, "dash": "dot"}
                )
    return figure


def tip_path(run: RunData) -> go.Figure | None:
    """Path of the tip and path asked for, in the base frame."""
    _, actual, wanted = tip_positions(run)
    if not len(actual):
        return None
    figure = go.Figure([
        path_line(wanted, "reference", {"color": MUTED, "width": 9}),
        path_line(actual, "true", {"color": joint_colour(0), "width": 4}),
        path_point(actual[0], "start", "circle"),
        path_point(actual[-1], "end", "diamond"),
    ])  # fmt: skip
    style_path(figure)
    return figure


def tip_error(run: RunData) -> go.Figure | None:
    """True error of the tip along each axis of the base frame, scaled to its later part."""
    times_s, actual, wanted = tip_positions(run)
    if not len(times_s):
        return None
    errors = _MM * (actual - wanted)
    figure = go.Figure([
        line(times_s, error, joint_colour(index), axis)
        for index, (axis, error) in enumerate(zip("xyz", errors.T, strict=True))
    ])  # fmt: skip
    style(figure, 480, legend=True)
    figure.update_xaxes(title_text="time (s)")
    figure.update_yaxes(title_text="mm")
    late = times_s >= run.setup.scenario.metrics.from_s
    if late.any():
        limit = _HEADROOM * max(np.abs(errors[late]).max(), 1e-6)
        figure.update_yaxes(range=[-limit, limit])
    return figure


def network_output(run: RunData) -> go.Figure | None:
    """Output of the network and the dynamics it stands in for; None for a law without one."""
    figure = _joint_series(run, topics.CONTROL_STATUS, "network_output", "N m")
    if figure is None:
        return None
    times_s, truth = run.times_s(topics.PLANT_TRUTH), unknown_dynamics_nm(run)
    for joint in range(run.setup.robot.joints):
        trace = line(times_s, truth[:, joint], "rgba(123,135,148,0.55)", "true dynamics", 4.5)
        figure.add_trace(trace, row=joint + 1, col=1)
    figure.data = figure.data[::-1]  # what is drawn first lies below
    late = times_s >= run.setup.scenario.metrics.from_s
    if late.any():
        for joint, values in enumerate(truth[late].T):
            room = 0.3 * np.ptp(values) + 1.0
            figure.update_yaxes(range=[values.min() - room, values.max() + room], row=joint + 1)
    return figure


def unknown_dynamics_nm(run: RunData) -> Matrix:
    """M(q) q̈_d + C(q, q̇) q̇ + G(q) + friction + disturbance at every tick, shape (ticks, joints).

    With the true arm's M, C and G, payload included, and the reference acceleration q̈_d.
    """
    setup = run.setup
    model = ManipulatorModel(setup.robot, payload_kg=setup.scenario.plant.payload_kg)
    truth = run.tables[topics.PLANT_TRUTH.name]
    position, velocity = truth["position"], truth["velocity"]
    torque = truth["friction"] + truth["disturbance"]
    wanted, rate, acceleration = np.empty((3, setup.robot.joints))
    for tick, time_s in enumerate(run.times_s(topics.PLANT_TRUTH)):
        setup.reference.evaluate(float(time_s), wanted, rate, acceleration)
        torque[tick] += model.inverse_dynamics(position[tick], velocity[tick], acceleration)
    return np.asarray(torque)


def _errors(run: RunData, until_s: float) -> go.Figure | None:
    times_s = run.times_s(topics.PLANT_TRUTH)
    shown = times_s <= until_s
    if not shown.any():
        return None
    times_s, errors = times_s[shown], _MRAD * run.true_errors_rad[shown]
    outside = bound_usage(run)[shown] >= 1.0
    band_s = np.linspace(times_s[0], times_s[-1], _BAND_POINTS)
    upper, lower = (_MRAD * bound for bound in run.setup.funnel.bounds(band_s))
    figure = joint_rows(run.setup.robot.joint_names, "mrad")
    for joint in range(run.setup.robot.joints):
        traces = [
            *band(band_s, upper[:, joint], lower[:, joint]),
            line(times_s, errors[:, joint], joint_colour(joint), "true error"),
        ]
        out = outside[:, joint]
        if out.any():
            marks = line(times_s[out], errors[out, joint], ALARM, "outside the bounds")
            traces.append(marks.update(mode="markers", marker={"size": 3, "color": ALARM}))
        figure.add_traces(traces, rows=joint + 1, cols=1)
    figure.update_xaxes(range=[times_s[0], times_s[-1]])
    return figure


def _joint_series(run: RunData, topic: Topic, field: str, unit: str) -> go.Figure | None:
    """One field of a topic over time; None if it never has a value."""
    values = _per_joint(run, topic, field)
    if not np.isfinite(values).any():
        return None
    times_s, names = run.times_s(topic), run.setup.robot.joint_names
    figure = joint_rows(names, unit)
    for joint, name in enumerate(names):
        trace = line(times_s, values[:, joint], joint_colour(joint), html.escape(name))
        figure.add_trace(trace, row=joint + 1, col=1)
    return figure


def _per_joint(run: RunData, topic: Topic, field: str) -> Matrix:
    return np.asarray(run.tables[topic.name][field].reshape(-1, run.setup.robot.joints))


def tip_positions(run: RunData) -> tuple[Vector, Matrix, Matrix]:
    """Evenly spaced times (s), with the true and the reference position of the tip (m) at each."""
    truth = run.tables[topics.PLANT_TRUTH.name]
    truth = truth[:: max(1, len(truth) // _PATH_POINTS)]
    times_s, model = stamps_s(truth), ManipulatorModel(run.setup.robot)
    wanted = sample_positions(run.setup.reference, times_s, run.setup.robot.joints)
    actual, reference = (
        np.array([model.tip_position(position) for position in positions])
        for positions in (truth["position"], wanted)
    )
    return times_s, actual, reference


def path_line(points: Matrix, name: str, stroke: dict[str, object]) -> go.Scatter3d:
    """A path in space; points have shape (points, 3), m."""
    x, y, z = points.T
    return go.Scatter3d(x=x, y=y, z=z, name=name, mode="lines", line=stroke)


def path_point(point: Vector, name: str, symbol: str) -> go.Scatter3d:
    """A point in space, shape (3,), m."""
    x, y, z = point
    marker = {"size": 5, "color": INK, "symbol": symbol}
    return go.Scatter3d(x=[x], y=[y], z=[z], name=name, mode="markers", marker=marker)


def style_path(figure: go.Figure, height_px: float = _PATH_PX) -> None:
    """Give a figure of a path in space the report's looks."""
    style(figure, height_px, legend=True)
    axes = {f"{name}axis": {"title": {"text": f"{name} (m)"}, "nticks": 5} for name in "xyz"}
    figure.update_layout(
        scene={"aspectmode": "data", "camera": _PATH_CAMERA, **axes},
        margin={"l": 0, "r": 0, "b": 0},
        legend={"y": 0},
    )

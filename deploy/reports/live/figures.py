"""Figures of a live view: those of a report, without data; each trace names its values.

A trace's `meta` names its series of a frame (`deploy.reports.live.frames`) and its joint; the
browser adds the data.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import plotly.graph_objects as go

from bus_schema.arrays import Matrix
from controller.manipulator_model import ManipulatorModel
from controller.reference import sample_positions
from deploy.reports.figures import style
from deploy.reports.figures.space import show_in_space, skeletons
from deploy.scenario.setup import Setup
from plant_emulator.channel.opening import open_downlink, open_uplink

_HEADROOM = 1.3
_POSTURES = 200
_NOTHING: Any = []
WINDOW_S = 10.0
"""Time span of a run that the figures show."""


def live_figures(setup: Setup) -> dict[str, Any]:
    """Return the figures by the id of their HTML element, as Plotly's JSON."""
    draw = {"error": _errors, "torque": _torques, "age": _ages, "arm": _arm}
    return {name: style.with_template(each(setup).to_plotly_json()) for name, each in draw.items()}


def _errors(setup: Setup) -> go.Figure:
    upper, lower = style.band(_NOTHING, _NOTHING, _NOTHING)
    return _rows(setup, "mrad", {"upper": upper, "lower": lower, "error": _line()})


def _torques(setup: Setup) -> go.Figure:
    return _rows(setup, "N m", {"torque": _line()})


def _rows(setup: Setup, unit: str, series: dict[str, go.Scatter]) -> go.Figure:
    """Return a row per joint with a trace for each series, the last in the joint's colour."""
    figure = style.joint_rows(setup.robot.joint_names, unit)
    for joint in range(setup.robot.joints):
        traces = [
            go.Scatter(trace, meta={"series": name, "joint": joint})
            for name, trace in series.items()
        ]
        traces[-1].line.color = style.palette(joint)
        figure.add_traces(traces, rows=joint + 1, cols=1)
    return figure


def _ages(setup: Setup) -> go.Figure:
    """Return the figure of the age of the command in force, with its limit."""
    figure = style.new_figure(220, "time (s)", "ms")
    figure.add_trace(_line().update(name="age", meta={"series": "age_ms"}))
    deadline_ms = _deadline_ms(setup)
    figure.add_hline(
        deadline_ms, line={**style.DOTTED, "color": style.ALARM}, annotation_text="deadline"
    )
    figure.add_hline(_HEADROOM * deadline_ms, opacity=0)  # for which the axis makes room
    return figure.update_yaxes(rangemode="tozero")


def _deadline_ms(setup: Setup) -> float:
    """Return the largest allowed age of the state that the command in force answers."""
    link, seed = setup.link, setup.scenario.seed
    mean_ns = open_uplink(link, seed).mean_delay_ns + open_downlink(link, seed).mean_delay_ns
    return 1e-6 * link.deadline_ns(
        setup.answer_every * setup.grid.period_ns, max(mean_ns, link.playout_ns)
    )


def _arm(setup: Setup) -> go.Figure:
    """Return the arm in a cube, which grows in the browser if the arm leaves it."""
    figure = go.Figure([
        _in_space("reference", style.MUTED, 6).update(meta={"lines": "reference_arm"}),
        _in_space("arm", style.palette(0), 9).update(meta={"lines": "arm"}),
        _in_space("path of the tip", style.palette(1), 3).update(meta={"path": "arm"}),
    ], {"template": "none"})  # fmt: skip
    show_in_space(figure, _cube(setup), uirevision="arm")
    figure.update_layout(showlegend=True, margin={"t": 10})  # as high as its place on the page
    return figure


def _cube(setup: Setup) -> Matrix:
    """Return two opposite corners of the cube around all planned motion, shape (2, 3), m."""
    times_s = np.linspace(0.0, setup.scenario.duration_s, _POSTURES)
    wanted = sample_positions(setup.reference, times_s, setup.robot.joints)
    postures = np.vstack([setup.start_position_rad, wanted])
    points = skeletons(ManipulatorModel(setup.robot), postures).reshape(-1, 3)
    lower, upper = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    reach = (upper - lower).max() / 2
    return np.asarray(np.outer([-reach, reach], np.ones(3)) + (lower + upper) / 2)


def _line() -> go.Scatter:
    return style.line(_NOTHING, _NOTHING, style.palette(0), "")


def _in_space(name: str, colour: str, width: float) -> go.Scatter3d:
    stroke = {"color": colour, "width": width}
    return go.Scatter3d(x=[], y=[], z=[], name=name, mode="lines", line=stroke)

"""The figures of a live view: those of a report, without data, each trace with what it will show.

A trace's `meta` says which series of a frame (`deploy.live.frames`) it takes, and of which joint;
its data are added in the browser.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import plotly.graph_objects as go

from bus_schema.arrays import Matrix
from controller.manipulator_model import ManipulatorModel
from controller.reference import sample_positions
from deploy.reports.figure_json import with_template
from deploy.reports.figures import style
from deploy.reports.figures.arm.motion import skeletons
from deploy.reports.figures.arm.space import still_space
from deploy.reports.figures.template import without_template
from deploy.scenario.setup import Setup
from plant_emulator.channel.impairment import open_downlink, open_uplink

_HEADROOM = 1.3
_POSTURES = 200
WINDOW_S = 10.0
"""How much of a run the figures over time show."""


def live_figures(setup: Setup) -> dict[str, Any]:
    """Figures by the id of the element they are drawn in, as Plotly's JSON."""
    draw = {"error": _errors, "torque": _torques, "age": _ages, "arm": _arm}
    figures = {name: without_template(each, setup) for name, each in draw.items()}
    return {name: with_template(figure.to_plotly_json()) for name, figure in figures.items()}


def _errors(setup: Setup) -> go.Figure:
    figure = style.joint_rows(setup.robot.joint_names, "mrad")
    for joint in range(setup.robot.joints):
        upper, lower = style.band([], [], [])  # type: ignore[arg-type]
        error = _line(style.palette(joint))
        traces = [
            trace.update(meta={"series": series, "joint": joint})
            for series, trace in (("upper", upper), ("lower", lower), ("error", error))
        ]
        figure.add_traces(traces, rows=joint + 1, cols=1)
    return figure


def _torques(setup: Setup) -> go.Figure:
    figure = style.joint_rows(setup.robot.joint_names, "N m")
    for joint in range(setup.robot.joints):
        trace = _line(style.palette(joint)).update(meta={"series": "torque", "joint": joint})
        figure.add_trace(trace, row=joint + 1, col=1)
    return figure


def _ages(setup: Setup) -> go.Figure:
    """Age of the command in force, and from when on it is too old."""
    figure = go.Figure()
    figure.add_trace(_line(style.palette(0)).update(name="age", meta={"series": "age_ms"}))
    deadline_ms = _deadline_ms(setup)
    figure.add_hline(
        deadline_ms, line={**style.DOTTED, "color": style.ALARM}, annotation_text="deadline"
    )
    figure.add_hline(_HEADROOM * deadline_ms, opacity=0)  # which the axis makes room for
    style.apply(figure, 220)
    figure.update_xaxes(title_text="time (s)")
    figure.update_yaxes(title_text="ms", rangemode="tozero")
    return figure


def _deadline_ms(setup: Setup) -> float:
    """The oldest that a state may be which the command in force answers."""
    link, seed = setup.scenario.link, setup.scenario.seed
    mean_ns = open_uplink(link, seed).mean_delay_ns + open_downlink(link, seed).mean_delay_ns
    return 1e-6 * link.deadline_ns(setup.grid.period_ns, max(mean_ns, link.playout_ns))


def _arm(setup: Setup) -> go.Figure:
    """The arm in a cube, which grows in the browser where the arm leaves it."""
    figure = go.Figure([
        _in_space("reference", style.MUTED, 6).update(meta={"lines": "reference_arm"}),
        _in_space("arm", style.palette(0), 9).update(meta={"lines": "arm"}),
        _in_space("path of the tip", style.palette(1), 3).update(meta={"path": "arm"}),
    ])  # fmt: skip
    figure.update_layout(  # as high as the page has it
        showlegend=True,
        scene={"uirevision": "arm", **still_space(_cube(setup))},
        margin={"l": 0, "r": 0, "b": 0, "t": 10},
        legend={"y": 0},
    )
    return figure


def _cube(setup: Setup) -> Matrix:
    """Two opposite corners of the cube around all that the arm is to do, shape (2, 3), m."""
    times_s = np.linspace(0.0, setup.scenario.duration_s, _POSTURES)
    wanted = sample_positions(setup.reference, times_s, setup.robot.joints)
    postures = np.vstack([setup.start_position_rad, wanted])
    points = skeletons(ManipulatorModel(setup.robot), postures).reshape(-1, 3)
    lower, upper = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    reach = (upper - lower).max() / 2
    return np.asarray(np.outer([-reach, reach], np.ones(3)) + (lower + upper) / 2)


def _line(colour: str) -> go.Scatter:
    return go.Scatter(x=[], y=[], mode="lines", line={"color": colour, "width": 1.4})


def _in_space(name: str, colour: str, width: float) -> go.Scatter3d:
    stroke = {"color": colour, "width": width}
    return go.Scatter3d(x=[], y=[], z=[], name=name, mode="lines", line=stroke)

"""The figures of a live view: those of a report, without data, each trace with what it will show.

A trace's `meta` says which series of a frame (`deploy.live.frames`) it takes, and of which joint;
its data are added in the browser.
"""

from __future__ import annotations

from typing import Any

import plotly.graph_objects as go

from deploy.reports.figures import style
from deploy.scenario.setup import Setup
from plant_emulator.channel.impairment import open_downlink, open_uplink

_HEADROOM = 1.3
WINDOW_S = 10.0
"""How much of a run the figures over time show."""
_CAMERA = {"eye": {"x": 1.5, "y": 1.3, "z": 0.8}, "center": {"x": 0, "y": 0, "z": -0.1}}


def live_figures(setup: Setup) -> dict[str, Any]:
    """Figures by the id of the element they are drawn in, as Plotly's JSON."""
    figures = {
        "error": _errors(setup),
        "torque": _torques(setup),
        "age": _ages(setup),
        "arm": _arm(),
    }
    return {name: figure.to_plotly_json() for name, figure in figures.items()}


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


def _arm() -> go.Figure:
    figure = go.Figure([
        _in_space("reference", style.MUTED, 6).update(meta={"lines": "reference_arm"}),
        _in_space("arm", style.palette(0), 9).update(meta={"lines": "arm"}),
        _in_space("path of the tip", style.palette(1), 3).update(meta={"path": "arm"}),
    ])  # fmt: skip
    style.apply(figure, 480, legend=True)
    axes = {f"{name}axis": {"title": {"text": f"{name} (m)"}, "nticks": 5} for name in "xyz"}
    figure.update_layout(
        scene={"aspectmode": "data", "camera": _CAMERA, "uirevision": "arm", **axes},
        margin={"l": 0, "r": 0, "b": 0, "t": 10},
        legend={"y": 0},
    )
    return figure


def _line(colour: str) -> go.Scatter:
    return go.Scatter(x=[], y=[], mode="lines", line={"color": colour, "width": 1.4})


def _in_space(name: str, colour: str, width: float) -> go.Scatter3d:
    stroke = {"color": colour, "width": width}
    return go.Scatter3d(x=[], y=[], z=[], name=name, mode="lines", line=stroke)

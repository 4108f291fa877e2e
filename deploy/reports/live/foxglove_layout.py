"""A layout for Foxglove: the arm in 3-D, errors inside their funnel, torques, deadlines."""

from __future__ import annotations

from typing import Any

from bus_schema.messages import topics
from deploy.reports.figures import style
from deploy.scenario.setup import Setup

_LINE = {"enabled": True, "timestampMethod": "headerStamp", "showLine": True}
_FOLLOW_S = 10
_BOUND = "#9ab8cc"


def foxglove_layout(setup: Setup) -> dict[str, Any]:
    """Return the layout, as Foxglove imports it from a JSON file."""
    names = setup.robot.joint_names
    errors = {f"Plot!error{joint}": _error(joint, name) for joint, name in enumerate(names)}
    panels = {
        "3D!arm": _arm(),
        **errors,
        "Plot!torque": _plot("torque (N m)", [
            _line(f"/{topics.JOINT_COMMANDS.name}.effort[{joint}]", name, style.palette(joint))
            for joint, name in enumerate(names)
        ]),
        "Plot!age": _plot("age of the command in force (ns)", [
            _line(f"/{topics.PLANT_TRUTH.name}.command_age_ns", "age", style.palette(0))
        ]),
        "Plot!deadlines": _plot("deadlines missed", [
            _line("/deadlines.missed", "missed", style.ALARM, "receiveTime")
        ]),
    }  # fmt: skip
    left = _split("column", ["3D!arm", "Plot!deadlines"], 70)
    right = _split("column", ["Plot!torque", "Plot!age"], 65)
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _split("row", [left, _split("column", list(errors)), right]),
    }


def _arm() -> dict[str, Any]:
    return {
        "layers": {
            "urdf": {
                "layerId": "foxglove.Urdf", "instanceId": "urdf", "label": "arm", "visible": True,
                "sourceType": "topic", "topic": f"/{topics.ROBOT_DESCRIPTION.name}",
                "displayMode": "visual",
            },
            "grid": {"layerId": "foxglove.Grid", "instanceId": "grid", "visible": True, "size": 4},
        },
        "cameraState": {
            "perspective": True, "distance": 3, "phi": 65, "thetaOffset": 45,
            "targetOffset": [0, 0, 0.4], "target": [0, 0, 0], "fovy": 45, "near": 0.05, "far": 500,
        },
        "topics": {f"/{topics.ROBOT_DESCRIPTION.name}": {"visible": True}},
    }  # fmt: skip


def _error(joint: int, name: str) -> dict[str, Any]:
    """Return a plot of an error between its bounds, from the controller's status."""
    status = f"/{topics.CONTROL_STATUS.name}"
    return _plot(f"error of {name} (rad)", [
        _line(f"{status}.upper_bound[{joint}]", "upper bound", _BOUND),
        _line(f"{status}.lower_bound[{joint}]", "lower bound", _BOUND),
        _line(f"{status}.error[{joint}]", "error", style.palette(joint)),
    ])  # fmt: skip


def _plot(title: str, lines: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "foxglovePanelTitle": title,
        "paths": lines,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "showLegend": True,
        "legendDisplay": "floating",
        "isSynced": True,
        "xAxisVal": "timestamp",
        "followingViewWidth": _FOLLOW_S,
    }


def _line(path: str, label: str, colour: str, time: str = "headerStamp") -> dict[str, Any]:
    return {**_LINE, "timestampMethod": time, "value": path, "label": label, "color": colour}


def _split(direction: str, panels: list[Any], share: float | None = None) -> Any:
    """Return panels side by side in a direction; the first has its share, or all the same."""
    first, *others = panels
    if not others:
        return first
    return {
        "direction": direction,
        "first": first,
        "second": _split(direction, others),
        "splitPercentage": share or 100 / len(panels),
    }

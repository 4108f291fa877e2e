"""Figures and arrays as JSON: packed numbers of a precision to be looked at, and common looks.

Figures are made without the template of their looks, and get it when they are written or handed
out: as an object of Plotly's, loading and checking it would take as long as making all figures of
a report.
"""

from __future__ import annotations

import base64
import contextlib
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any

import numpy as np
import plotly.graph_objects as go
import plotly.io as pio
from numpy.typing import NDArray
from plotly.io.json import to_json_plotly

from deploy.reports.figures import style

_AXIS = {"gridcolor": style.GRID, "zerolinecolor": "#cbd2d9", "linecolor": "#cbd2d9"}
_OURS = {
    "margin": {"l": 62, "r": 14, "t": style.TOP_PX, "b": style.BOTTOM_PX},
    "font": {"family": style.FONT, "size": 12, "color": style.INK},
    "hoverlabel": {"font": {"family": style.FONT}},
    "legend": {"orientation": "h", "x": 0, "y": -0.2, "yanchor": "top"},
    "xaxis": {**_AXIS, "showline": True, "ticks": "outside", "tickcolor": "#cbd2d9"},
    "yaxis": {**_AXIS, "exponentformat": "power"},
}


@cache
def template() -> dict[str, Any]:
    """Plotly's own on white, with what is ours: as it stands in a figure's JSON."""
    plotlys = pio.templates["plotly_white"].to_plotly_json()
    return {"layout": _merged(plotlys["layout"], _OURS)}


@contextlib.contextmanager
def no_template() -> Iterator[None]:
    """Meanwhile Plotly gives no figure its own template."""
    before = pio.templates.default
    pio.templates.default = None
    try:
        yield
    finally:
        pio.templates.default = before


def _merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """A nested table in which each change takes the place of what was there."""
    return {
        **base,
        **{
            key: _merged(base.get(key, {}), value) if isinstance(value, dict) else value
            for key, value in changes.items()
        },
    }


def figure_json(figure: go.Figure) -> str:
    """A figure as plotly.js reads it, with the looks that all have."""
    return str(to_json_plotly(_packed(with_template(figure.to_dict()))))


def with_template(figure: dict[str, Any]) -> dict[str, Any]:
    """A figure's JSON with the looks that all have."""
    return {**figure, "layout": {"template": template(), **figure["layout"]}}


def typed_array(values: NDArray[Any]) -> dict[str, str]:
    """Numbers as plotly.js has them in one dimension: seven digits are more than can be seen."""
    data = np.ascontiguousarray(values, dtype="<f4").tobytes()
    return {"dtype": "f4", "bdata": base64.b64encode(data).decode()}


def _packed(value: Any) -> Any:
    """A part of a figure, with the arrays in it that Plotly has packed made half as large."""
    if isinstance(value, dict):
        if value.get("dtype") == "f8" and "shape" not in value:
            return typed_array(np.frombuffer(base64.b64decode(value["bdata"]), "<f8"))
        return {key: _packed(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_packed(each) for each in value]
    return value

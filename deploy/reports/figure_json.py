"""Figures and arrays as JSON: numbers as packed typed arrays, of a precision to be looked at."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.io.json import to_json_plotly

from deploy.reports.figures.template import template


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

"""Figures of sweeps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import plotly.graph_objects as go

from deploy.reports.figures import style
from deploy.reports.figures.study_figures import DrawnStudy, StudyQuantity
from deploy.reports.studies.study_result import Runs
from deploy.reports.tables import number
from deploy.study.study import shown_value

_HEAT = [[0.0, "#f3f8fb"], [0.5, "#6aa5cc"], [1.0, "#0b3c5d"]]


def heat_map(
    study: DrawnStudy,
    x: tuple[str, Sequence[Any]],
    y: tuple[str, Sequence[Any]],
    rows: Sequence[Sequence[Runs | None]],
    quantity: StudyQuantity,
) -> go.Figure:
    """Means over two swept keys.

    Args:
        study: the study.
        x: title and values of the horizontal axis.
        y: title and values of the vertical axis.
        rows: a row per value of `y`; None leaves a field white.
        quantity: what is drawn.
    """
    means = [
        [None if runs is None else quantity.value(runs, "mean") for runs in row] for row in rows
    ]
    texts = [["" if mean is None else number(mean) for mean in row] for row in means]
    crowded = len(x[1]) * len(y[1]) > 150
    field = go.Heatmap(
        x=[style.plain(shown_value(value)) for value in x[1]],
        y=[style.plain(shown_value(value)) for value in y[1]],
        z=means, zmin=0.0, zmax=max((m for row in means for m in row if m), default=1.0),
        customdata=[list(map(study.rerun_worst, row)) for row in rows],
        text=texts, texttemplate=None if crowded else "%{text}",
        colorscale=_HEAT, xgap=1, ygap=1, hoverongaps=False,
        colorbar={"title": {"text": quantity.axis, "side": "right"}, "thickness": 12},
        hovertemplate="%{x} · %{y}: %{text}<extra></extra>",
    )  # fmt: skip
    height_px = 140 + max(240, min(34 * len(y[1]), 600))
    figure = style.new_figure(height_px, x[0], y[0], [field])
    figure.update_xaxes(type="category", showgrid=False)
    return figure.update_yaxes(type="category", showgrid=False)

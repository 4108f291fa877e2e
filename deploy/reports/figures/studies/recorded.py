"""Figures of recorded runs side by side.

Every function gives None where there is nothing to draw.
"""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from bus_schema.messages import topics
from deploy.comparison.comparison import Comparison
from deploy.comparison.recorded import ticks_in_common
from deploy.reports.figures import style
from deploy.reports.figures.laws import add_envelopes, law_colour, with_law_legend
from deploy.reports.figures.timing import percentile_axes, percentile_curve
from deploy.runs.judging.metrics import times_us

_TRUTH = topics.PLANT_TRUTH


def positions_apart(runs: Comparison) -> go.Figure | None:
    """How far each run's positions are from those of the first, at the same instant."""
    first = runs.runs[0].data
    own = first.tables[_TRUTH.name]["position"]
    figure = with_law_legend(style.joint_rows(first.setup.robot.joint_names, "mrad"))
    for run in runs.drawn:
        theirs = run.data.tables[_TRUTH.name]["position"]
        here, there = ticks_in_common(first, run.data)
        apart = style.MRAD * (theirs[there] - own[here])
        if run is not runs.runs[0] and len(here) > 1 and apart.any():
            add_envelopes(figure, runs, run.law, first.times_s(_TRUTH)[here], apart)
    return figure if figure.data else None


def time_percentiles(runs: Comparison, key: str) -> go.Figure | None:
    """One of the times of a summary by percentile, a line for each run."""
    values = {run.law: times_us(run.data)[key] for run in runs.runs}
    shown = {label: each for label, each in values.items() if len(each) and each.max() > 0.0}
    if not shown:
        return None
    figure = go.Figure()
    for label, each in shown.items():
        figure.add_trace(percentile_curve(label, each, law_colour(runs, label)))
    style.apply(figure, 380, legend=True)
    percentile_axes(figure, int(np.max([len(each) for each in shown.values()])))
    return figure

"""A figure in the report of a run: the speeds of its joints."""

from __future__ import annotations

import plotly.graph_objects as go

from bus_schema.messages import topics
from deploy.reports.page import Panel
from deploy.study.comparison.compared_runs import ComparedRuns


def _speeds(runs: ComparedRuns) -> go.Figure:
    data = runs.runs[0].data
    times_s, truth = data.times_s(topics.PLANT_TRUTH), data.tables[topics.PLANT_TRUTH.name]
    figure = go.Figure(layout={"xaxis_title": "t in s", "yaxis_title": "speed in rad/s"})
    for joint, name in enumerate(data.setup.robot.joint_names):
        figure.add_scatter(x=times_s, y=truth["velocity"][:, joint], name=name)
    return figure


SPEEDS = Panel(
    "Motion", "speeds", "Speeds of the joints", _speeds, "They end at zero.", is_over_time=True
)

"""Chunks of a slow law over time: which answer was in force, how old, and where targets jumped."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from bus_schema.messages import topics
from bus_schema.messages.run_event import EventKind
from bus_schema.messages.topics import Role
from deploy.judge.motion.chunks import Jump, chunks
from deploy.judge.run_data import RunData
from deploy.reports.figures import style
from deploy.reports.tables import number

_HEIGHT_PX, _MOST, _LANES = 320, 300, 4


def chunks_over_time(run: RunData) -> go.Figure | None:
    """Draw each answer from its question to its end, and the jumps between them; None without any.

    The first 300 answers are shown; the largest jump has the name of its joint.
    """
    told = run.last_values(Role.CONTROLLER, EventKind.ENDED).get("chunks", {})
    switches = np.array(told.get("first_switches", ())[: _MOST + 1])
    found = chunks(run)
    if not len(switches) or found is None or found.jump_rad is None:
        return None
    at_s, asked_s = switches[:, :2].T
    ends_s = np.append(at_s[1:], max(at_s[-1], run.times_s(topics.PLANT_TRUTH)[-1]))
    figure = make_subplots(rows=2, shared_xaxes=True, vertical_spacing=0.08)
    for lane in range(min(_LANES, len(at_s))):
        here, colour = slice(lane, None, _LANES), style.palette(lane)
        for begins, ends, width in ((asked_s, at_s, 1.5), (at_s, ends_s, 9)):
            figure.add_scatter(
                x=style.apart(begins[here], ends[here]), y=_level(lane, begins[here]), mode="lines",
                line={"color": colour, "width": width}, showlegend=False, row=1, col=1,
            )  # fmt: skip
    _add_jumps(figure, found.jumps[: _MOST + 1])
    style.apply(figure, _HEIGHT_PX)
    figure.update_yaxes(title="answer", showticklabels=False, row=1, col=1)
    figure.update_yaxes(title="jump (mrad)", row=2, col=1)
    return figure.update_xaxes(title="time (s)", row=2, col=1)


def _add_jumps(figure: go.Figure, jumps: list[Jump]) -> None:
    """Add a bar for each jump, and the joint's name at the largest."""
    largest = max((each.jump_rad for each in jumps), default=0.0)
    texts = [
        f"{each.joint}, tip {number(each.jump_mm)} mm" if each.jump_rad == largest > 0.0 else ""
        for each in jumps
    ]
    figure.add_bar(
        x=[each.time_s for each in jumps], y=[style.MRAD * each.jump_rad for each in jumps],
        text=texts, textposition="outside", cliponaxis=False, showlegend=False,
        customdata=[(each.joint, number(each.jump_mm)) for each in jumps],
        marker={"color": style.ALARM}, row=2, col=1,
        hovertemplate="%{customdata[0]}: %{y:.3g} mrad, tip %{customdata[1]} mm<extra></extra>",
    )  # fmt: skip


def _level(lane: int, begins: np.ndarray) -> np.ndarray:
    return np.full(3 * len(begins), float(lane))

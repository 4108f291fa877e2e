"""The timeline of a run: what controller and plant were doing, and when something went wrong."""

from __future__ import annotations

import plotly.graph_objects as go

from bus_schema.messages.run_event import EventKind
from bus_schema.messages.topics import Role
from bus_schema.runtime.modes import Mode, mode_in
from deploy.reports.figures import style
from deploy.runs.run_data import RunData

_ROLES = (Role.PLANT, Role.CONTROLLER)
_COLOURS = {
    Mode.IDLE: "#cbd2d9",
    Mode.READY: "#7fb5d6",
    Mode.TRACKING: "#009e73",
    Mode.STOPPING: "#e08e0b",
    Mode.FAULT: style.ALARM,
}
_MARKS = {EventKind.FAULT: ("x", style.ALARM), EventKind.LIMIT: ("triangle-down", style.INK)}
_HEIGHT_PX, _BELOW_PX = 240, 105
_LEAST_SHARE = 0.004


def timeline(run: RunData) -> go.Figure | None:
    """The modes of both sides over time, with faults and first touches of a limit.

    What lasts an instant is drawn wide enough to be seen.
    """
    spans = [(role, *span) for role in _ROLES for span in mode_spans(run, role)]
    if not spans:
        return None
    end_s = max(span[3] for span in spans)
    figure = go.Figure()
    for mode in reversed(Mode):
        own = [(role, start, end) for role, its, start, end in spans if its is mode]
        name = mode.name.lower()
        figure.add_bar(
            y=[str(role) for role, _, _ in own],
            base=[start for _, start, _ in own],
            x=[max(end - start, _LEAST_SHARE * end_s) for _, start, end in own],
            orientation="h", name=name, marker={"color": _COLOURS[mode], "line": {"width": 0}},
            hovertext=[f"{name} {start:.3f} s to {end:.3f} s" for _, start, end in own],
            hoverinfo="text",
        )  # fmt: skip
    for kind, (symbol, colour) in _MARKS.items():
        events = [event for event in run.events if event.kind == kind and event.source in _ROLES]
        if events:
            figure.add_scatter(
                x=[event.stamp_ns * 1e-9 for event in events],
                y=[event.source for event in events], mode="markers", name=str(kind),
                marker={"symbol": symbol, "size": 10, "color": colour,
                        "line": {"color": "white", "width": 1}},
                hovertext=[style.plain(event.detail) for event in events], hoverinfo="text+x",
            )  # fmt: skip
    style.apply(figure, _HEIGHT_PX, legend=True)
    figure.update_layout(
        barmode="overlay",
        bargap=0.35,
        margin={"b": _BELOW_PX},  # the legend takes two rows where a page is narrow
        legend={"yref": "container", "y": 0, "yanchor": "bottom", "traceorder": "reversed"},
    )
    figure.update_xaxes(title_text="time (s)", range=[0.0, max(end_s, 1e-9) * 1.01])
    figure.update_yaxes(categoryorder="array", categoryarray=[str(role) for role in _ROLES])
    return figure


def mode_spans(run: RunData, role: Role) -> list[tuple[Mode, float, float]]:
    """Mode, start and end in s of all that a side told of."""
    told = [e for e in run.events if e.source == role and e.kind == EventKind.MODE]
    changes = [(mode, e.stamp_ns * 1e-9) for e in told if (mode := mode_in(e.detail)) is not None]
    if not changes:
        return []
    ends = [start_s for _, start_s in changes[1:]]
    ends.append(max(event.stamp_ns * 1e-9 for event in run.events))
    return [(mode, start, end) for (mode, start), end in zip(changes, ends, strict=True)]

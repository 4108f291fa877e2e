"""What the reports of sweeps and margins have in common: their page, and figures to click on."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import plotly.graph_objects as go

from deploy.reports.page import Panel, plot

Rerun = Callable[[str], str]
"""Gives the command that runs a point again."""

Summary = dict[str, Any]


@dataclass(frozen=True)
class StudyPage:
    """What the report of a study says.

    Attributes:
        kind: what it is a report of.
        level: ``good``, ``mixed`` or ``bad``.
        headline: the result in one line.
        reasons: sentences below it.
        tiles: labels and values below these.
        sections: figures by title of their section.
        header: of the table of results.
        rows: of the table of results.
        points: each point's description and name.
    """

    kind: str
    level: str
    headline: str
    reasons: Sequence[str]
    tiles: Sequence[tuple[str, str]]
    sections: Mapping[str, Sequence[Panel[Summary]]]
    table_title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    table_note: str
    points: Sequence[tuple[str, str]] = field(default_factory=list)


def clickable(name: str, title: str, caption: str, figure: go.Figure | None) -> Panel[Summary]:
    """A panel that shows the command of the point that was clicked on."""

    def content(summary: Summary, panel_id: str) -> str:
        shown = plot(lambda _: figure)(summary, panel_id)
        return (
            f"{shown}<output>Click on a point for the command that runs it again.</output>"
            if shown
            else ""
        )

    return Panel(name, title, caption, content)

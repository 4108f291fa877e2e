"""The page around a report: one HTML file that holds everything it needs and opens offline."""

from __future__ import annotations

import html
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from string import Template
from typing import Generic, TypeVar

import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

T = TypeVar("T")
"""What a report is about: a run, or several."""


@dataclass(frozen=True)
class Panel(Generic[T]):
    """A figure with its title, caption and id; `content` gives its HTML, or nothing to show."""

    id: str
    title: str
    caption: str
    content: Callable[[T, str], str]


def page(title: str, template: str, values: Mapping[str, str]) -> str:
    """A whole page.

    Args:
        title: plain text.
        template: file name of the template of the page's body.
        values: what the template asks for, as HTML.
    """
    body = _template(template).substitute(values)
    return _template("page.html").substitute(
        title=html.escape(title), plotly_js=get_plotlyjs(), body=body
    )


def render_sections(sections: Mapping[str, Sequence[Panel[T]]], subject: T) -> str:
    """All sections of figures; those without a figure to show are left out."""
    rendered = []
    for title, panels in sections.items():
        shown = "".join(_figure(panel, subject) for panel in panels)
        if shown:
            rendered.append(f'<h2>{html.escape(title)}</h2>\n<div class="panels">{shown}</div>\n')
    return "".join(rendered) or "<h2>Figures</h2><p>Nothing was recorded that could be drawn.</p>"


def plot(draw: Callable[[T], go.Figure | None]) -> Callable[[T, str], str]:
    """The content of a panel that shows a plotly figure."""

    def content(subject: T, panel_id: str) -> str:
        figure = draw(subject)
        if figure is None:
            return ""
        data = figure.to_json().replace("<", "\\u003c")  # nothing in it can end the script element
        return (
            f'<div id="{panel_id}-plot" style="height: {figure.layout.height}px"></div>'
            f'<script type="application/json" data-plot="{panel_id}-plot">{data}</script>'
        )

    return content


def _template(name: str) -> Template:
    return Template(
        resources.files("deploy.reports").joinpath("templates", name).read_text("utf-8")
    )


def _figure(panel: Panel[T], subject: T) -> str:
    content = panel.content(subject, panel.id)
    if not content:
        return ""
    return (
        f'<figure class="card" id="{panel.id}"><h3>{html.escape(panel.title)}</h3>{content}'
        f"<figcaption>{html.escape(panel.caption)}</figcaption></figure>\n"
    )

"""The page of a report: one HTML file that holds everything it needs and opens offline."""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

import plotly.graph_objects as go
from jinja2 import Environment, PackageLoader, StrictUndefined
from plotly.offline import get_plotlyjs

from bus_schema.recording.atomic_files import write_whole
from deploy.reports.tables import Table

T = TypeVar("T")
"""What a report is about: a run, or several."""


class Fact(NamedTuple):
    """A labelled value at the top of a report; `hint` says more of it."""

    label: str
    value: str
    hint: str = ""


@dataclass(frozen=True)
class Picture:
    """A picture of the arm at a time of a run."""

    time_s: float
    png: bytes

    @property
    def source(self) -> str:
        return f"data:image/png;base64,{base64.b64encode(self.png).decode()}"


@dataclass(frozen=True)
class Panel(Generic[T]):
    """A figure of a report.

    Attributes:
        section: title of the section that it stands in.
        id: of its HTML element, and the only one of this name in a page.
        title: of the figure.
        draw: gives the figure, pictures or a table; None where there is nothing to draw.
        caption: what to look for in it.
        is_clickable: whether its points carry, as `customdata`, a text to be shown on a click.
    """

    section: str
    id: str
    title: str
    draw: Callable[[T], go.Figure | Sequence[Picture] | Table | None]
    caption: str
    is_clickable: bool = False


def write_page(
    path: Path, template: str, panels: Iterable[Panel[T]], subject: T, **values: Any
) -> None:
    """Write a report.

    Args:
        path: the HTML file.
        template: file name of the template of this kind of report.
        panels: its figures, in order.
        subject: what they show.
        values: what else the template asks for: always `title`, `verdict`, `facts`
            and `conditions`.
    """
    sections: dict[str, list[tuple[Panel[T], Any]]] = {}
    for panel in panels:
        content = panel.draw(subject)
        if content is not None:
            sections.setdefault(panel.section, []).append((panel, content))
    html = _ENVIRONMENT.get_template(template).render(
        plotly_js=get_plotlyjs(), sections=sections, **values
    )
    write_whole(path, html)


_ENVIRONMENT = Environment(
    loader=PackageLoader("deploy.reports"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
)
_ENVIRONMENT.policies["json.dumps_function"] = lambda figure, **_: figure.to_json()
_ENVIRONMENT.tests["figure"] = lambda content: isinstance(content, go.Figure)
_ENVIRONMENT.tests["table"] = lambda content: isinstance(content, Table)

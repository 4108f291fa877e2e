"""The page of a report: one HTML file that holds everything it needs and opens offline.

But for reports of studies, which share a file with the library that draws their figures.
"""

from __future__ import annotations

import base64
import contextlib
import json
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeAlias, TypeVar

import numpy as np
import plotly.graph_objects as go
from jinja2 import Environment, PackageLoader, StrictUndefined
from numpy.typing import NDArray
from plotly.offline import get_plotlyjs

from bus_schema.arrays import Vector
from bus_schema.recording.atomic_files import write_whole
from deploy.reports.figures.style import figure_json, typed_array
from deploy.reports.tables import Table
from deploy.reports.verdict import ReportHead
from deploy.run.stop_signals import end_if_asked

LIBRARY_FILE = "plotly.min.js"
_FAST = 1  # three times as fast as the usual level, for a sixth more

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
class Motion:
    """A figure in space whose first traces move along a run.

    Attributes:
        figure: as it is at the first of the times.
        times_s: rising, shape (frames,).
        points: of each trace at each time, shape (frames, traces, points, 3), m.
    """

    figure: go.Figure
    times_s: Vector
    points: NDArray[np.float64]

    def frames(self) -> dict[str, Any]:
        """Times and points for the page, ready for JSON."""
        _, traces, points, _ = self.points.shape
        arrays = {"times": typed_array(self.times_s), "points": typed_array(self.points.ravel())}
        return {"traces": traces, "points_of_each": points, **arrays}


Content: TypeAlias = go.Figure | Sequence[Picture] | Motion | Table


@dataclass(frozen=True)
class Panel(Generic[T]):
    """A figure of a report.

    Attributes:
        section: title of the section that it stands in.
        id: of its HTML element, and the only one of this name in a page.
        title: of the figure.
        draw: gives the figure, pictures, a motion or a table; None where there is nothing to draw.
        caption: what to look for in it.
        is_clickable: whether its points carry, as `customdata`, a text to be shown on a click.
        is_over_time: whether its horizontal axis is the time of a run, on which the page shows the
            instant that is looked at.
        is_drawn_beside: whether `draw` begins what another process does, and gives a function that
            waits for that and does the rest once the other panels are drawn.
    """

    section: str
    id: str
    title: str
    draw: Callable[[T], Content | Callable[[], Content] | None]
    caption: str
    is_clickable: bool = False
    is_over_time: bool = False
    is_drawn_beside: bool = False


class Cards(NamedTuple):
    """Tables beside each other: ``three`` narrow ones, or ``stacked`` over all of the width."""

    tables: Sequence[Table]
    layout: str = ""


@dataclass(frozen=True)
class Page(Generic[T]):
    """What a report says.

    Attributes:
        kind: what it is a report of.
        name: of that, which begins the title.
        verdict: its top.
        facts: labelled values below that.
        panels: its figures, in order.
        subject: what they show.
        conditions: under which that came about.
        before: title of tables before the figures, and these.
        after: title of tables behind the figures, and these.
        points: description, file and command of points of a study that can be run again.
        points_title: what points these are.
        points_note: what a reader must know to run one.
        end_s: end of the runs whose figures over time share an instant; None for no run.
        footer: what a reader may look for next.
        footer_code: the name or number that ends it.
    """

    kind: str
    name: str
    verdict: ReportHead
    facts: Sequence[Fact]
    panels: Iterable[Panel[T]]
    subject: T
    conditions: Mapping[str, str] = field(default_factory=dict)
    before: tuple[str, Sequence[Cards]] = ("", ())
    after: tuple[str, Sequence[Cards]] = ("", ())
    points: Sequence[tuple[str, str, str]] = ()
    points_title: str = "Every point, with the command that repeats it"
    points_note: str = ""
    end_s: float | None = None
    footer: str = ""
    footer_code: str = ""


def write_page(path: Path, page: Page[T], *, shares_library: bool = False) -> None:
    """Write a report to an HTML file.

    Args:
        path: the file.
        page: what it says.
        shares_library: whether the library of the figures goes beside it, for other reports, too.
    """
    if shares_library:
        share_library(path.parent)
    address = library_address(path)
    with ThreadPoolExecutor(max_workers=1) as beside:
        packing = None if address else beside.submit(packed_library)  # a tenth of a second and more
        sections = _drawn(list(page.panels), page.subject)
        packed = "" if packing is None else packing.result()
    html = _ENVIRONMENT.get_template("page.html").render(
        page=page, sections=sections, library=address, packed_library=packed
    )
    write_whole(path, html)


def _drawn(panels: Sequence[Panel[T]], subject: T) -> dict[str, list[tuple[Panel[T], Any]]]:
    """Panels with what they show, by section; without those that have nothing to show."""
    contents: dict[str, Any] = {}
    for panel in sorted(panels, key=lambda panel: not panel.is_drawn_beside):
        end_if_asked()
        contents[panel.id] = panel.draw(subject)
    sections: dict[str, list[tuple[Panel[T], Any]]] = {}
    for panel in panels:
        content = contents[panel.id]
        if callable(content):
            content = content()
        if content is not None:
            sections.setdefault(panel.section, []).append((panel, content))
    return sections


@cache
def packed_library() -> str:
    """The library as base64 of what ``DecompressionStream("deflate")`` unpacks."""
    return base64.b64encode(zlib.compress(get_plotlyjs().encode(), _FAST)).decode()


def share_library(folder: Path) -> None:
    """Put the library beside the reports of a folder; where it cannot be, each has its own."""
    if not _has_library(folder):
        with contextlib.suppress(OSError):
            write_whole(folder / LIBRARY_FILE, get_plotlyjs())


def library_address(report: Path) -> str:
    """Where a report finds a shared library: beside it or one folder up; "" where there is none."""
    if _has_library(report.parent):
        return LIBRARY_FILE
    return f"../{LIBRARY_FILE}" if _has_library(report.parent.parent) else ""


def _has_library(folder: Path) -> bool:
    """Whether a folder has the library, and of this version."""
    file = folder / LIBRARY_FILE
    return file.is_file() and file.read_bytes() == get_plotlyjs().encode()


_ENVIRONMENT = Environment(
    loader=PackageLoader("deploy.reports"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
)
_ENVIRONMENT.policies["json.dumps_function"] = lambda content, **_: (
    figure_json(content) if isinstance(content, go.Figure) else json.dumps(content)
)
_ENVIRONMENT.tests["figure"] = lambda content: isinstance(content, go.Figure)
_ENVIRONMENT.tests["motion"] = lambda content: isinstance(content, Motion)
_ENVIRONMENT.tests["table"] = lambda content: isinstance(content, Table)

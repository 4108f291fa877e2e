"""A page as one HTML file that holds everything it needs and opens offline.

Reports of studies share the file of the library that draws their figures.
"""

from __future__ import annotations

import base64
import contextlib
import json
import re
import zlib
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

import plotly.graph_objects as go
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape
from plotly.offline import get_plotlyjs

from bus_schema.recording.atomic_files import write_whole
from deploy.reports.figures.style import figure_json
from deploy.reports.page import Motion, Page, Panel, T
from deploy.reports.tables import Table
from deploy.run.stop_signals import end_if_asked

LIBRARY_FILE = "plotly.min.js"
_FAST = 1  # three times as fast as the usual level, for a sixth more


def write_page(path: Path, page: Page[T]) -> None:
    """Write a report to an HTML file.

    Args:
        path: the file.
        page: what it says.
    """
    if page.shares_library:
        share_library(path.parent)
    address = library_address(path)
    with ThreadPoolExecutor(max_workers=1) as beside:
        packing = None if address else beside.submit(packed_library)  # a tenth of a second and more
        lead, *sections = _drawn(list(page.panels()), page.subject) or [("", [])]
        packed = "" if packing is None else packing.result()
    html = _ENVIRONMENT.get_template("page.html").render(
        page=page, lead=lead, sections=sections, library=address, packed_library=packed
    )
    write_whole(path, html)


def _drawn(panels: Sequence[Panel[T]], subject: T) -> list[tuple[str, list[Any]]]:
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
    return list(sections.items())


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
    """Return the address of a shared library: beside the report or one folder up; "" for none."""
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
_ENVIRONMENT.filters["breakable"] = lambda text: Markup(  # names go on below after a _ or a .
    str(escape(text))
    if " " in text
    else re.sub(r"([_.])(?=[A-Za-z])", r"\1<wbr>", str(escape(text)))
)
_ENVIRONMENT.filters["with_options"] = lambda text: Markup(  # no break after the first hyphens
    re.sub(r"--[a-z-]+", r'<span class="option">\g<0></span>', str(escape(text)))
)
_ENVIRONMENT.tests["figure"] = lambda content: isinstance(content, go.Figure)
_ENVIRONMENT.tests["motion"] = lambda content: isinstance(content, Motion)
_ENVIRONMENT.tests["table"] = lambda content: isinstance(content, Table)

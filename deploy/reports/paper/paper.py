"""Files of a result for a paper: figures, tables as LaTeX, and a citation with its digest."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from bus_schema.errors import InputError, needs_extra
from deploy.reports.page import Page
from deploy.reports.paper.latex import latex_text
from deploy.reports.results import Results

FORMATS = ("pdf", "svg")


def write_figures(
    page: Page[Any], folder: Path, formats: Sequence[str], columns: int
) -> Iterator[Path]:
    """Write every figure of a page that is in the plane; yield the files.

    Raises:
        InputError: Matplotlib is not installed.
    """
    try:
        from deploy.reports.paper.paper_figures import can_be_drawn, write_figure  # an extra
    except ImportError as error:
        raise InputError(f"--figures: {needs_extra('matplotlib', 'papers')}") from error
    for panel in page.panels():
        drawn: Any = panel.draw(page.subject)
        figure = drawn() if callable(drawn) else drawn
        if not can_be_drawn(figure):
            continue
        for each in formats:
            file = folder / f"{panel.id}.{each}"
            write_figure(figure, file, columns)
            yield file


def write_bibtex(results: Results, page: Page[Any], file: Path) -> Path:
    """Write a citation: the version that made the results, their year, and their digest."""
    digest = digest_of_results(results)
    entry = {
        "title": "{funnel-hil}: a hardware-in-the-loop test bench for prescribed-performance and"
        " fixed-time robot control",
        "author": "{the funnel-hil authors}",
        "version": page.conditions.get("version", "").removeprefix("funnel-hil "),
        "year": page.conditions.get("date", "")[:4],
        "note": latex_text(f"results of {page.name}, digest {digest}"),
    }
    fields = ",\n".join(f"  {key} = {{{value}}}" for key, value in entry.items() if value)
    file.write_text(f"@software{{funnel_hil_{digest[:8]},\n{fields}\n}}\n", encoding="utf-8")
    return file


def digest_of_results(results: Results) -> str:
    """Return the digest of a run, or one of the summary of a study without date and host."""
    own = results.summary.get("digest")
    if isinstance(own, str):
        return own[:16]
    kept = json.loads(json.dumps(results.summary), object_hook=_without_conditions)
    return hashlib.sha256(json.dumps(kept, sort_keys=True).encode()).hexdigest()[:16]


def _without_conditions(part: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in part.items() if key != "conditions"}

"""Reports of sweeps and margins, made of their summaries alone."""

from __future__ import annotations

import html
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from bus_schema.recording.atomic_files import write_whole
from deploy.reports.margin_panels import margin_page
from deploy.reports.page import page, render_sections
from deploy.reports.study_panels import Rerun, StudyPage
from deploy.reports.sweep_panels import sweep_page
from deploy.reports.tables import table, tile
from deploy.study.folder import StudyFolder


def write_study_report(summary: dict[str, Any], folder: StudyFolder) -> None:
    """Write the report of a sweep or of margins to its folder."""
    make: Callable[[dict[str, Any], Rerun], StudyPage]
    make = sweep_page if summary["kind"] == "sweep" else margin_page
    content = make(summary, folder.rerun_command)
    values = {
        "kind": html.escape(content.kind),
        "level": content.level,
        "headline": html.escape(content.headline),
        "reasons": "".join(f"<li>{html.escape(reason)}</li>" for reason in content.reasons),
        "tiles": _tiles(summary, content),
        "figures": render_sections(content.sections, summary) if summary["runs"] else "",
        "table_title": html.escape(content.table_title),
        "table": table(content.header, content.rows),
        "table_note": html.escape(content.table_note),
        "points": _point_table(content.points, folder),
        "seed_note": _seed_note(summary["seeds"]),
        "rows_file": html.escape(folder.rows_file.name),
    }
    title = f"{summary['name']} · {content.headline}"
    write_whole(folder.report, page(title, "study.html", values))


def _tiles(summary: dict[str, Any], content: StudyPage) -> str:
    runs = f"{summary['runs']}" if summary["completed"] else f"{summary['runs']}, not complete"
    return "".join(
        [
            *(tile(label, value) for label, value in content.tiles),
            tile("Runs", runs),
            tile("Failed runs", str(summary["runs_failed"])),
            tile("Seeds", _shortened(summary["seeds"])),
        ]
    )


def _point_table(points: Iterable[tuple[str, str]], folder: StudyFolder) -> str:
    """A row per point: what it is, a link to its scenario, and the command that runs it again."""
    rows = "".join(
        f'<tr><th scope="row">{html.escape(name)}</th>'
        f'<td><a href="scenarios/{point}.yaml">{point}.yaml</a></td>'
        f"<td><code>{html.escape(folder.rerun_command(point))}</code></td></tr>"
        for name, point in points
    )
    return f'<div class="scroll"><table class="events"><tbody>{rows}</tbody></table></div>'


def _seed_note(seeds: Sequence[int]) -> str:
    note = f"The scenarios have seed {seeds[0]}"
    return (
        f"{note}; add --set seed={seeds[1]} and so on for the others." if seeds[1:] else f"{note}."
    )


def _shortened(seeds: Sequence[int]) -> str:
    texts = [str(seed) for seed in seeds]
    return ", ".join(texts) if len(texts) <= 6 else f"{len(texts)}: {texts[0]} … {texts[-1]}"

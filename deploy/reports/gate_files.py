"""Files of a gate: JUnit XML, a Markdown table, and the page of its history."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from bus_schema.foreign_text import markdown_table, printable
from bus_schema.recording.atomic_files import write_whole
from deploy.judge.gate import ENTRIES, ENTRY, Entry, Gauged
from deploy.reports.page import Fact, Page, Panel, ReportHead

if TYPE_CHECKING:
    import plotly.graph_objects as go


def write_junit(
    file: Path, found: Sequence[Gauged], failures: Mapping[str, str], note: str = ""
) -> None:
    """Write a test case for each number, as CI services read it, and a note about all."""
    suite = ET.Element(
        "testsuite", name="funnel-hil", tests=str(len({*failures, *(each.name for each in found)})),
        failures=str(len(failures)),
    )  # fmt: skip
    for name, text in _texts(found, failures).items():
        case = ET.SubElement(suite, "testcase", classname="funnel-hil", name=name)
        if name in failures:
            ET.SubElement(case, "failure", message=failures[name])
        ET.SubElement(case, "system-out").text = text
    if note:
        ET.SubElement(suite, "system-out").text = note
    text = ET.tostring(suite, encoding="unicode", xml_declaration=True)
    write_whole(file, printable(text))


def write_markdown(file: Path, found: Sequence[Gauged], failures: Mapping[str, str]) -> None:
    """Write a table of the numbers."""
    rows = [
        [name, text, failures[name].removeprefix(f"{name}: ") if name in failures else "ok"]
        for name, text in _texts(found, failures).items()
    ]
    write_whole(file, markdown_table(["", "found", ""], rows))


def _texts(found: Sequence[Gauged], failures: Mapping[str, str]) -> dict[str, str]:
    return dict.fromkeys(failures, "missing") | {each.name: each.text for each in found}


def write_history(folder: Path, name: str, entries: Sequence[Entry], unit: str) -> None:
    """Write all entries, and the page that draws them."""
    from deploy.reports.html import write_page  # heavy

    lines = (f"{ENTRY.dump_json(entry).decode()}\n" for entry in entries)
    write_whole(folder / ENTRIES, "".join(lines))
    sentence = f"The last is of {entries[-1].commit}."
    page = Page(
        "history", name,
        ReportHead("good", f"{len(entries)} results", [sentence]),
        [Fact("Unit", unit or "none")],
        lambda: [Panel("History", "history", f"{name} over commits",
                       lambda all_: _figure(all_, unit),
                       "A gap is a result in which the bounds were never kept.")],
        list(entries),
    )  # fmt: skip
    write_page(folder / "history.html", page)


def _figure(entries: Sequence[Entry], unit: str) -> go.Figure:
    from deploy.reports.figures import style  # heavy

    figure, places = style.new_figure(430, y_title=unit, legend=True), list(range(len(entries)))
    names = dict.fromkeys(name for entry in entries for name in entry.values)
    for index, name in enumerate(names):
        figure.add_scatter(
            x=places, y=[entry.values.get(name) for entry in entries], name=name,
            mode="lines+markers", line={"color": style.palette(index)},
        )  # fmt: skip
    labels = [f"{entry.commit}<br>{entry.time[:10]}" for entry in entries]
    figure.update_xaxes(tickvals=places, ticktext=labels)
    return figure.update_yaxes(rangemode="tozero")

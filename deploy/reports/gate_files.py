"""What a gate leaves for others: JUnit XML, a table in Markdown, and a history over commits."""

from __future__ import annotations

import json
import os
import subprocess
import time
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import plotly.graph_objects as go

from bus_schema.recording.atomic_files import write_whole
from deploy.reports.figures import style
from deploy.reports.gate import Gauged
from deploy.reports.page import Fact, Page, Panel, write_page
from deploy.reports.verdict import ReportHead
from deploy.scenario.yaml_files import ScenarioError

_ENTRIES = "history.jsonl"
Entry = dict[str, Any]


def write_junit(file: Path, found: Sequence[Gauged], failures: Mapping[str, str]) -> None:
    """Write a test case for each number, as CI services read it."""
    suite = ET.Element(
        "testsuite", name="funnel-hil", tests=str(len({*failures, *(each.name for each in found)})),
        failures=str(len(failures)),
    )  # fmt: skip
    for name, text in _texts(found, failures).items():
        case = ET.SubElement(suite, "testcase", classname="funnel-hil", name=name)
        if name in failures:
            ET.SubElement(case, "failure", message=failures[name])
        ET.SubElement(case, "system-out").text = text
    write_whole(file, ET.tostring(suite, encoding="unicode", xml_declaration=True))


def write_markdown(file: Path, found: Sequence[Gauged], failures: Mapping[str, str]) -> None:
    """Write a table of the numbers."""
    lines = ["| | found | |", "|---|---|---|"]
    for name, text in _texts(found, failures).items():
        result = failures[name].partition(": ")[2] if name in failures else "ok"
        lines.append(f"| {name} | {text} | {result} |")
    write_whole(file, "\n".join([*lines, ""]))


def _texts(found: Sequence[Gauged], failures: Mapping[str, str]) -> dict[str, str]:
    return dict.fromkeys(failures, "missing") | {each.name: each.text for each in found}


def read_history(folder: Path) -> list[Entry]:
    """Earlier results, the oldest first.

    Raises:
        ScenarioError: a line of ``history.jsonl`` is not one of ours.
    """
    file = folder / _ENTRIES
    if not file.is_file():
        return []
    entries = []
    for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(), 1):
        try:
            entry = json.loads(line)
            entries.append({"commit": entry["commit"], "time": entry["time"],
                            "values": dict(entry["values"])})  # fmt: skip
        except (ValueError, KeyError, TypeError) as error:
            raise ScenarioError(
                f"{file}, line {number}: must be an entry of this history (commit, time, values)"
            ) from error
    return entries


def write_history(folder: Path, name: str, entries: Sequence[Entry], unit: str) -> None:
    """Write all entries, and the page that draws them."""
    folder.mkdir(parents=True, exist_ok=True)
    write_whole(folder / _ENTRIES, "".join(f"{json.dumps(entry)}\n" for entry in entries))
    last = entries[-1]
    page = Page(
        "history", name,
        ReportHead("good", f"{len(entries)} results", [f"The last is of {last['commit']}."]),
        [Fact("Unit", unit or "none")],
        [Panel("History", "history", f"{name} over commits", lambda all_: _figure(all_, unit),
               "A gap is a result in which the bounds were never kept.")],
        list(entries),
    )  # fmt: skip
    write_page(folder / "history.html", page)


def _figure(entries: Sequence[Entry], unit: str) -> go.Figure:
    figure, places = go.Figure(), list(range(len(entries)))
    names = dict.fromkeys(name for entry in entries for name in entry["values"])
    for index, name in enumerate(names):
        figure.add_scatter(
            x=places, y=[entry["values"].get(name) for entry in entries], name=name,
            mode="lines+markers", line={"color": style.palette(index)},
        )  # fmt: skip
    labels = [f"{entry['commit']}<br>{entry['time'][:10]}" for entry in entries]
    figure.update_xaxes(tickvals=places, ticktext=labels)
    figure.update_yaxes(title_text=unit, rangemode="tozero")
    style.apply(figure, 430, legend=True)
    return figure


def entry_of(found: Sequence[Gauged]) -> Entry:
    """The entry of a result at this commit."""
    return {
        "commit": _commit(),
        "time": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "values": {each.name: each.value for each in found},
    }


def since_when(entries: Sequence[Entry], gauge: Gauged) -> str:
    """What a number was when it was last better, and at which commit it fell; empty if never."""
    known = [(entry["commit"], entry["values"].get(gauge.name)) for entry in entries]
    for place in reversed(range(len(known))):
        commit, value = known[place]
        if value is not None and (gauge.value is None or gauge.is_below(value)):
            fell = known[place + 1][0] if place + 1 < len(known) else _commit()
            return f"; it was {value:.4g} at {commit}, and fell at {fell}"
    return ""


def _commit() -> str:
    """The commit that is tested: of the CI service, or of the folder; "unknown" without."""
    if sha := os.environ.get("GITHUB_SHA") or os.environ.get("CI_COMMIT_SHA"):
        return sha[:8]
    command = ["git", "rev-parse", "--short=8", "HEAD"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=5)
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return done.stdout.strip()

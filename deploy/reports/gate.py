"""A gate: the numbers of a result that must not be small, or smaller than before.

A study of margins is gated by each margin, a sweep, comparison or run by the smallest distance of
an error to its bound, in percent of the bound. It leaves JUnit XML, a table in Markdown, and a
history over commits.
"""

from __future__ import annotations

import os
import re
import subprocess
import time
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from bus_schema.configuration import shown
from bus_schema.recording.atomic_files import write_whole
from deploy.judge.verdict import Verdict
from deploy.reports.study_texts import case_name
from deploy.run.run_folder import read_json
from deploy.scenario.yaml_files import ScenarioError
from deploy.study.study import OF_BOUND, shown_value

_ENTRIES = "history.jsonl"
_SIZE = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+))\s*(\S*)\s*")


@dataclass(frozen=True)
class Gauged:
    """One number of a result.

    Attributes:
        name: of what it is the number: an arm, a law, a point of a sweep.
        value: None if even the easiest case was lost.
        unit: of the value; empty if it has none.
        sign: 1 if larger values are better, -1 if smaller ones are.
    """

    name: str
    value: float | None
    unit: str
    sign: int = 1

    @property
    def text(self) -> str:
        if self.value is None:
            return "none"
        return f"{self.value:.4g} {self.unit}".rstrip()

    def is_below(self, limit: float) -> bool:
        """Whether it does not reach a limit."""
        return self.value is None or self.sign * (self.value - limit) < 0


@dataclass(frozen=True)
class Entry:
    """The result of a commit, and its numbers by name."""

    commit: str
    time: str
    values: dict[str, float | None]


_ENTRY = TypeAdapter(Entry)


@dataclass(frozen=True)
class Gate:
    """What the numbers of a result must reach.

    Attributes:
        at_least: the smallest allowed value; None for any.
        baseline: numbers of an earlier result, by name.
        tolerance: by how much a number may be worse than the earlier one.
        unit: of `at_least` and `tolerance` as given; empty if none was given.
    """

    at_least: float | None = None
    baseline: Mapping[str, Gauged] = field(default_factory=dict)
    tolerance: float = 0.0
    unit: str = ""

    def failures(self, found: Sequence[Gauged]) -> dict[str, str]:
        """A sentence for each number that fell too low, by its name."""
        sentences = {each.name: self._failure(each) for each in found}
        names = {each.name for each in found}
        missing = {name: f"{name}: is missing" for name in self.baseline if name not in names}
        return {name: said for name, said in sentences.items() if said} | missing

    def _failure(self, found: Gauged) -> str:
        """Why a number fell too low; empty if it did not."""
        if self.at_least is not None and found.is_below(self.at_least):
            word = "at least" if found.sign > 0 else "at most"
            limit = f"{self.at_least:g} {found.unit}".rstrip()
            return f"{found.name}: {found.text}, must be {word} {limit}"
        before = self.baseline.get(found.name)
        if before is None or before.value is None:
            return ""
        if not found.is_below(before.value - before.sign * self.tolerance):
            return ""
        by = "" if found.value is None else f" by {abs(before.value - found.value):.4g}"
        unit = found.unit and f" {found.unit}"
        return (
            f"{found.name}: fell{by} from {before.text} to {found.text}, more than the"
            f" {self.tolerance:g}{unit} allowed"
        )


def build_gate(at_least: str | None, baseline: Path | None, tolerance: str | None) -> Gate:
    """The gate that options ask for.

    Raises:
        ScenarioError: a number cannot be read, or the baseline holds no results.
    """
    if tolerance is not None and baseline is None:
        raise ScenarioError(f"--tolerance {tolerance}: needs --baseline")
    limit, unit = _size("--at-least", at_least)
    allowed, other = _size("--tolerance", tolerance)
    if unit and other and unit != other:
        raise ScenarioError(f"--tolerance {tolerance}: must have the unit of --at-least, {unit}")
    if allowed is not None and not allowed >= 0.0:
        raise ScenarioError(f"--tolerance {tolerance}: must be 0 or more")
    found = []
    if baseline is not None:
        found = gauged(read_json(baseline / "summary.json" if baseline.is_dir() else baseline))
    if baseline is not None and not found:
        raise ScenarioError(
            f"--baseline {baseline}: must be summary.json of a run or study, or its folder"
        )
    return Gate(limit, {each.name: each for each in found}, allowed or 0.0, unit or other)


def require_unit(gate: Gate, unit: str) -> None:
    """Check that a gate's numbers are in the unit of a result.

    Raises:
        ScenarioError: they, or those of the baseline, are not.
    """
    if gate.unit and gate.unit != unit.partition(" ")[0]:
        raise ScenarioError(
            f"--at-least or --tolerance: unit {shown(gate.unit)}: must be"
            f" {unit.partition(' ')[0] or 'left out'}, because the result is in"
            f" {unit or 'no unit'}"
        )
    for each in gate.baseline.values():
        if each.unit != unit:
            raise ScenarioError(
                f"--baseline: {each.name} is in {each.unit or 'no unit'}: must be a result in"
                f" {unit or 'no unit'}"
            )


def gauged(summary: Mapping[str, Any]) -> list[Gauged]:
    """The numbers of a ``summary.json`` that a gate looks at."""
    kind = summary.get("kind", "run")
    if kind in ("margin", "robustness"):
        key = "margin" if kind == "margin" else "kept_up_to"
        return [
            Gauged(f"{case['arm']}, {case_name(case)}", case[key], summary["unit"] or "",
                   1 if case.get("growth", 1) > 0 else -1)
            for case in summary["cases"]
        ]  # fmt: skip
    if kind == "sweep":
        return [_point(summary, point) for point in summary["points"]]
    runs = summary["laws"].values() if kind == "comparison" else [summary]
    return [_run(run) for run in runs if "law" in run]


def _point(summary: Mapping[str, Any], point: Mapping[str, Any]) -> Gauged:
    values = zip(summary["axes"], point["values"], strict=True)
    name = ", ".join(f"{', '.join(axis['keys'])} = {shown_value(value)}" for axis, value in values)
    is_kept, smallest = point["runs_kept"] == point["runs"], point["margin_min"]["lowest"]
    return Gauged(name, 100.0 * smallest if is_kept else None, OF_BOUND)


def _run(summary: Mapping[str, Any]) -> Gauged:
    name = f"{summary['scenario']}, {summary['law']}"
    is_kept = summary["verdict"] == Verdict.KEPT
    return Gauged(name, 100.0 * summary["bounds"]["margin_min"] if is_kept else None, OF_BOUND)


def _size(option: str, text: str | None) -> tuple[float | None, str]:
    """A number and its unit from ``20ms``."""
    if text is None:
        return None, ""
    found = _SIZE.fullmatch(text)
    if found is None:
        raise ScenarioError(f"{option} {shown(text)}: must be a number, such as 20 or 20ms")
    return float(found[1]), found[2]


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
    """Return earlier results, the oldest first.

    Raises:
        ScenarioError: a line of ``history.jsonl`` is not one of ours.
    """
    file, entries = folder / _ENTRIES, []
    lines = file.read_text(encoding="utf-8").splitlines() if file.is_file() else []
    for number, line in enumerate(lines, 1):
        try:
            entries.append(_ENTRY.validate_json(line))
        except ValidationError as error:
            raise ScenarioError(
                f"{file}, line {number}: must be an entry of this history (commit, time, values)"
            ) from error
    return entries


def write_history(folder: Path, name: str, entries: Sequence[Entry], unit: str) -> None:
    """Write all entries, and the page that draws them."""
    from deploy.reports.page import Fact, Page, Panel, write_page  # heavy
    from deploy.reports.verdict import ReportHead

    folder.mkdir(parents=True, exist_ok=True)
    lines = (f"{_ENTRY.dump_json(entry).decode()}\n" for entry in entries)
    write_whole(folder / _ENTRIES, "".join(lines))
    said = f"The last is of {entries[-1].commit}."
    page = Page(
        "history", name,
        ReportHead("good", f"{len(entries)} results", [said]),
        [Fact("Unit", unit or "none")],
        [Panel("History", "history", f"{name} over commits", lambda all_: _figure(all_, unit),
               "A gap is a result in which the bounds were never kept.")],
        list(entries),
    )  # fmt: skip
    write_page(folder / "history.html", page)


def _figure(entries: Sequence[Entry], unit: str) -> Any:
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


def entry_of(found: Sequence[Gauged]) -> Entry:
    """The entry of a result at this commit."""
    values = {each.name: each.value for each in found}
    return Entry(_commit(), time.strftime("%Y-%m-%dT%H:%M:%S%z"), values)


def since_when(entries: Sequence[Entry], gauge: Gauged) -> str:
    """What a number was when it was last better, and at which commit it fell; empty if never."""
    fell = ""
    for entry in reversed(entries):
        value = entry.values.get(gauge.name)
        if value is not None and (gauge.value is None or gauge.is_below(value)):
            return f"; it was {value:.4g} at {entry.commit}, and fell at {fell or _commit()}"
        fell = entry.commit
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

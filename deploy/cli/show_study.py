"""What people see of a sweep or of margins in the terminal: progress, and the result."""

from __future__ import annotations

import time
from typing import Any

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

from deploy.reports.study_text import held_again, margin_text, shown_value
from deploy.reports.tables import number
from deploy.runs.run_rows import Row

_PLAIN_LINE_S = 5.0
_SHOWN_POINTS = 40
_COMPENSATION = {None: "", False: "without", True: "with"}


class _Rate(ProgressColumn):
    """Runs per second."""

    def render(self, task: Task) -> Text:
        return Text(f"{task.speed:.2f} runs/s" if task.speed else "– runs/s")


class StudyProgress:
    """Progress over all runs: a live line on a terminal, a plain line now and then elsewhere."""

    def __init__(self, console: Console, name: str, expected: int) -> None:
        self._console = console
        self._started_s = self._last_line_s = time.monotonic()
        self._expected, self._before, self._now, self._failed = expected, 0, 0, 0
        self._bar = Progress(
            TextColumn("[bold]{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            _Rate(),
            TimeRemainingColumn(compact=True),
            TextColumn("{task.fields[failed]}"),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._task = self._bar.add_task(escape(name), total=expected, failed="")

    def __enter__(self) -> StudyProgress:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()
        if self._before:
            self._console.print(f"{self._before} runs were there from before")
        if not self._console.is_terminal:
            self._line()

    def done(self, values: Row, expected: int, *, before: bool) -> None:
        """A run is done, now or by an earlier command; `expected` runs there will be in all."""
        self._expected = expected
        self._failed += values["error"] is not None
        if before:
            self._before += 1
            self._bar.update(self._task, total=expected - self._before)
            return
        self._now += 1
        failed = f"{self._failed} failed" if self._failed else ""
        left = expected - self._before
        self._bar.update(self._task, completed=self._now, total=left, failed=failed)
        due = time.monotonic() - self._last_line_s >= _PLAIN_LINE_S
        if due and not self._console.is_terminal:
            self._line()

    def _line(self) -> None:
        self._last_line_s = time.monotonic()
        rate = self._now / max(self._last_line_s - self._started_s, 1e-9)
        done = self._before + self._now
        left = f"{(self._expected - done) / rate:.0f} s left" if rate else "no run done yet"
        failed = f", {self._failed} failed" if self._failed else ""
        self._console.print(
            f"{done} of {self._expected} runs, {rate:.2f} runs/s, {left}{failed}", highlight=False
        )


def show_study(console: Console, summary: dict[str, Any]) -> None:
    """The result as a table."""
    if summary["kind"] == "margin":
        console.print(_margins(summary))
        for sentence in held_again(summary):
            console.print(sentence, markup=False)
    else:
        console.print(_points(summary))
    hidden = len(summary.get("points", ())) - _SHOWN_POINTS
    if hidden > 0:
        console.print(f"{hidden} more points are in the report")
    if summary["runs_failed"]:
        console.print(f"[bold red]{summary['runs_failed']} runs failed[/]; their rows say why")


def _margins(summary: dict[str, Any]) -> Table:
    table = _table(f"{summary['name']} · largest {summary['title']} at which the bounds are kept")
    for heading in ("arm", "law", "compen-\nsation"):
        table.add_column(heading, no_wrap=True)
    for heading in ("held", "failed", "outside\nthen %"):
        table.add_column(heading, justify="right", no_wrap=True)
    for case in summary["cases"]:
        failed = next((p for p in case["probes"] if p["value"] == case["first_failure"]), None)
        outside = failed["violation_fraction"]["mean"] if failed else None
        table.add_row(
            case["arm"], case["law"], _COMPENSATION[case["compensation"]],
            margin_text(case, summary), number(case["first_failure"]), number(outside, 100.0),
        )  # fmt: skip
    return table


def _points(summary: dict[str, Any]) -> Table:
    table = _table(f"{summary['name']} · {summary['scenario']}")
    for axis in summary["axes"]:
        keys = [key.replace(".", ".\n") for key in axis["keys"]]
        table.add_column("\n".join(keys), overflow="fold")
    for heading in ("bounds\nkept", "outside\n%", "RMS mrad,\nworst\njoint", "failed"):
        table.add_column(heading, justify="right")
    for point in summary["points"][:_SHOWN_POINTS]:
        table.add_row(
            *(escape(shown_value(value)) for value in point["values"]),
            f"{point['runs_kept']} of {point['runs']}",
            number(point["violation_fraction"]["mean"], 100.0),
            number(point["worst_rms_rad"]["mean"], 1e3),
            str(point["runs_failed"] or ""),
        )
    return table


def _table(title: str) -> Table:
    return Table(title=escape(title), title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1))

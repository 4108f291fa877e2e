"""What people see of a sweep or of margins in the terminal."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from rich.console import Console

from deploy.cli.progress import CommandProgress
from deploy.reports.study_tables import held_again, margin_table, point_table
from deploy.reports.terminal import print_table
from deploy.runs.run_rows import Row

_SHOWN_POINTS = 40


class RunCounter:
    """Counts the runs of a study on a progress."""

    def __init__(self, progress: CommandProgress) -> None:
        self._progress = progress
        self._done = self._before = self._failed = 0

    def done(self, values: Row, expected: int, *, before: bool) -> None:
        """A run is done, now or by an earlier command; `expected` runs there will be in all."""
        self._done += 1
        self._before += before
        self._failed += values["error"] is not None
        notes = {"runs were there from before": self._before, "failed": self._failed}
        note = ", ".join(f"{count} {what}" for what, count in notes.items() if count)
        self._progress.skip_to(self._before)
        self._progress.update(self._done, total=expected, note=note)


def show_study(console: Console, summary: dict[str, Any]) -> None:
    """The result as a table."""
    if summary["kind"] == "margin":
        print_table(console, margin_table(summary))
        for sentence in held_again(summary):
            console.print(sentence, markup=False)
    else:
        table = point_table(summary)
        print_table(console, replace(table, rows=table.rows[:_SHOWN_POINTS]))
    hidden = len(summary.get("points", ())) - _SHOWN_POINTS
    if hidden > 0:
        console.print(f"{hidden} more points are in the report")
    if summary["runs_failed"]:
        console.print(f"[bold red]{summary['runs_failed']} runs failed[/]; their rows say why")

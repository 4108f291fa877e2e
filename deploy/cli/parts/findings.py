"""The findings of `doctor`, and the table that shows them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from rich.text import Text

from deploy.reports.terminal import open_table
from deploy.run.console import Console

Status = Literal["ok", "limited", "missing"]
_STYLES = {"ok": "green", "limited": "yellow", "missing": "red"}


@dataclass(frozen=True)
class Finding:
    """One resource or setting that a run can use.

    Attributes:
        name: what it is.
        status: ``limited`` means that runs work, but less well or not all of them.
        found: what was found.
        cost: what it costs a run where the status is not ``ok``.
    """

    name: str
    status: Status
    found: str
    cost: str


def show(findings: list[Finding], console: Console) -> None:
    """Print the findings as a table, with the cost of each one that is not ok."""
    rows: list[list[str | Text]] = []
    for finding in findings:
        text = Text(finding.found)
        if finding.status != "ok":
            text.append(f"\n→ {finding.cost}", style="dim")
        rows.append([finding.name, Text(finding.status, style=_STYLES[finding.status]), text])
    table = open_table(None, ["Thing", "Status", "Found, and what it costs"], rows)
    for column in table.columns[:2]:
        column.no_wrap = True
    console.print(table)

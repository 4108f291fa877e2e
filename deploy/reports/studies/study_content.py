"""What the reports of sweeps and of margins have in common."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from deploy.reports.page import Fact, Panel
from deploy.reports.tables import Table
from deploy.reports.verdict import ReportHead

Summary = dict[str, Any]


class Study(NamedTuple):
    """A sweep or margins: the summary, and what gives the command that runs a point again."""

    summary: Summary
    rerun: Callable[[str], str]


@dataclass(frozen=True)
class StudyContent:
    """What the report of a study says.

    Attributes:
        kind: what it is a report of.
        verdict: its top.
        facts: labelled values below that.
        panels: its figures.
        results: its tables.
        points: description and name of points that can be run again.
        points_title: what points these are.
    """

    kind: str
    verdict: ReportHead
    facts: Sequence[Fact]
    panels: Sequence[Panel[Study]]
    results: Sequence[Table]
    points: Sequence[tuple[str, str]]
    points_title: str = "Every point, with the command that runs it again"

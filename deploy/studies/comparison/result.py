"""The numbers of a comparison that a gate reads."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

from pydantic import Field

from deploy.judge.gate import Gauged
from deploy.reports.gauges import GaugedRun, GaugedSummary


class ComparisonResult(GaugedSummary):
    """A comparison: of each law what a run has."""

    other_units = GaugedRun.other_units
    laws: Annotated[dict[str, GaugedRun], Field(min_length=1)]

    def numbers(self) -> Iterator[Gauged]:
        for run in self.laws.values():
            yield from run.numbers()

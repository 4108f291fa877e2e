"""The numbers of a tuning that a gate reads: none."""

from __future__ import annotations

from collections.abc import Iterator

from deploy.judge.gate import Gauged
from deploy.reports.gauges import GaugedSummary


class TuneResult(GaugedSummary):
    """A tuning, whose costs are for its search alone: no numbers."""

    group = "tune"

    def numbers(self) -> Iterator[Gauged]:
        return iter(())

"""The numbers of a benchmark that a gate reads."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

from pydantic import Field

from deploy.judge.gate import Finite, Gauged
from deploy.reports.gauges import GaugedSummary, Part


class _Cell(Part):
    scenario: str
    law: str
    predictor: str
    gains: str
    any_pattern_ms: Finite


class BenchmarkResult(GaugedSummary):
    """A benchmark: the largest delay that each cell keeps in any pattern."""

    group = "benchmark"
    cells: Annotated[list[_Cell], Field(min_length=1)]

    def numbers(self) -> Iterator[Gauged]:
        for cell in self.cells:
            name = f"{cell.scenario}, {cell.law}, {cell.predictor}, {cell.gains} gains"
            yield Gauged(name, cell.any_pattern_ms, "ms")

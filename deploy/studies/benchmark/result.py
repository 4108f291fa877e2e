"""The result of a benchmark, as ``summary.json`` has it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

from pydantic import Field

from deploy.judge.gate import Finite, Gauged
from deploy.judge.result.section import PerJoint
from deploy.reports.studies.study_result import Share, StudyResult
from deploy.reports.tables import Shown
from deploy.studies.benchmark.cells import Cell
from deploy.study.statistics import worst


class PlantsKept(Share):
    """The uncertain plants that keep a delay."""

    round_trip_ms: float


class CellResult(Cell):
    """A cell with its margins.

    Attributes:
        margin_ms: the largest constant delay that is kept; 0 for none.
        any_pattern_ms: the largest that is also kept as each pattern of delays.
        rms_rad: at the smallest delay, of each joint.
        travel_nm_per_s: total variation of the torque there.
        networks: kept windows of each network.
        losses: runs lost at the smallest delay, by reason.
    """

    margin_ms: Annotated[float, Shown("Constant", "ms")] = 0.0
    any_pattern_ms: Annotated[Finite, Shown("Any pattern", "ms")]
    rms_rad: PerJoint | None = None
    travel_nm_per_s: PerJoint | None = None
    networks: dict[str, Share] = Field(default={})
    plants_kept: list[PlantsKept] = Field(default=[])
    losses: dict[str, int] = Field(default={})

    @property
    def entry(self) -> tuple[str, str, str]:
        """Law, predictor, and whether its gains are given or tuned."""
        return self.law, self.predictor, self.gains

    @property
    def worst_rms_rad(self) -> float | None:
        """The error of the worst joint; None if one is unknown."""
        return worst(self.rms_rad)

    @property
    def worst_travel_nm_per_s(self) -> float | None:
        """The travel of the worst joint; None if one is unknown."""
        return worst(self.travel_nm_per_s)

    def fraction(self, network: str) -> float | None:
        """Return the share of the windows of a network that were kept."""
        return self.networks[network].fraction if network in self.networks else None


class BenchmarkResult(StudyResult):
    """A benchmark: the largest delay that each cell keeps in any pattern."""

    group = "benchmark"
    runs_expected: int = 0
    delays_ms: list[float] = Field(default=[])
    networks: list[str] = Field(default=[])
    windows: int = 0
    plants: int | None = None
    plant_seed: int = 1
    cells: Annotated[list[CellResult], Field(min_length=1)]

    def numbers(self) -> Iterator[Gauged]:
        for cell in self.cells:
            name = f"{cell.scenario}, {cell.law}, {cell.predictor}, {cell.gains} gains"
            yield Gauged(name, cell.any_pattern_ms, "ms")

    def names(self, key: str) -> list[str]:
        """Return the different values of its cells."""
        return list(dict.fromkeys(getattr(cell, key) for cell in self.cells))

"""The result of a tuning, as ``summary.json`` has it."""

from __future__ import annotations

from collections.abc import Iterator

from pydantic import Field

from deploy.judge.gate import Gauged
from deploy.judge.result.section import PerJoint
from deploy.reports.gauges import Part
from deploy.reports.studies.study_result import StudyResult
from deploy.studies.tune.gain_search import Gains


class Judged(Part):
    """Runs with some gains at a place: their error, or the largest delay up to which all hold."""

    place: str
    runs: int
    kept: int
    rms_rad: PerJoint | None = None
    kept_up_to_ms: float | None = None


class TunedLaw(Part):
    """A law and its search.

    Attributes:
        history: the best cost so far after each candidate; null for one of earlier versions that
            was infinite.
        gains: those of the start, and those that were found.
        judged: runs with each of them, a part for each place.
        file: scenario with the gains that were found.
    """

    candidates: int
    cost_start: float | None
    cost_found: float | None
    best_candidate: int
    history: list[float | None]
    gained_in_last_quarter: float | None
    spread: float | None
    converged: bool
    gains: dict[str, Gains]
    judged: dict[str, list[Judged]]
    file: str | None = None


class TuneResult(StudyResult):
    """A tuning, whose costs are for its search alone: no numbers."""

    group = "tune"
    scenario: str = ""
    goal: str = "rms"
    budget: int = 0
    search_seed: int = 1
    delays_ms: list[float] | None = None
    travel_limit_per_s: float | None = None
    joint_names: list[str] = Field(default=[])
    runs_expected: int = 0
    laws: dict[str, TunedLaw]

    def numbers(self) -> Iterator[Gauged]:
        return iter(())

"""The result of a study of margins, as ``summary.json`` has it."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from deploy.reports.gauges import Part
from deploy.reports.studies.case_result import CaseResult, CasesResult, TriedValue
from deploy.study.quoted import Because


class Probe(TriedValue):
    """A value that was tried.

    Attributes:
        held: whether all its runs kept their bounds; None if that is not decided.
        points: all its points.
    """

    held: bool | None = None
    points: list[str] = Field(default=[])


class Ends(Part):
    """Ends of a search.

    Attributes:
        margin: the last value up to which all were kept; None for none.
        first_failure: the first lost value; None for none up to the limit.
        growth: 1 if values grow, −1 if they shrink.
        completed: whether the search is over.
    """

    margin: float | None = None
    first_failure: float | None = None
    growth: int | float = 1
    completed: bool = False


class ModelError(Ends):
    """The search with an unknown of the arm at its worst."""

    change: str = ""


class WorstPattern(Part):
    """The worst pattern of delays, and the margin for every pattern."""

    margin: float
    value: float = 0.0
    pattern: dict[str, Any] = Field(default={})
    point: str = ""
    command: str = ""
    trace_command: str | None = None


class Patterns(Part):
    """Number of patterns that were tried."""

    tried: int = 0


class Growth(Part):
    """Growth of a loop that is unstable without a delay."""

    rate_per_s: float
    frequency_hz: float
    joint: str


class Theory(Part):
    """Delays that the linear loop tolerates, or the reason why there is no linear loop."""

    reason: str | None = None
    constant_ms: float | None = None
    any_pattern_ms: float | None = None
    joint: str | None = None
    unstable_ms: list[list[float | None]] | None = None
    unstable_without_delay: Growth | None = None

    @property
    def knows_windows(self) -> bool:
        """Whether it has all windows of unstable delays."""
        return "constant_ms" in self.model_fields_set


class Remedy(Part):
    """A change that was tried at the first failure."""

    change: str
    held: bool
    point: str
    seed: int
    starts: int | None = None
    margin_min: float | None = None
    worst_rms_rad: float | None = None


class Remedies(Part):
    """Changes that were tried at a value."""

    value: float
    tried: list[Remedy]


class Disturbance(Part):
    """Up to where a case holds with messages lost, late or overtaken."""

    disturbance: str
    bridge: bool
    held_up_to: float | None = None
    lost_at: float | None = None


class MarginCase(CaseResult, Ends):
    """A case with its margin.

    Attributes:
        quoted: the number to quote, the smallest that is known; older results have only `margin`.
        quoted_because: the test that supports no larger one, see `Because`.
        guaranteed: up to where every pattern holds, as the motion is the same in all; None if not.
    """

    quoted: float | None = None
    quoted_because: str | None = None
    widest_gap: float = 0.0
    margin_on: dict[str, float | None] = Field(default={})
    held_again: list[float] = Field(default=[])
    probes: list[Probe] = Field(default=[])
    guaranteed: float | None = None
    guaranteed_d_ms: float | None = None
    scenario_d_ms: float | None = None
    guaranteed_command: str | None = None
    worst_pattern: WorstPattern | None = None
    patterns: Patterns = Field(default=Patterns())
    disturbances: list[Disturbance] | None = None
    what_helps: Remedies | None = None
    smaller_rotors: ModelError | None = None
    model_errors: list[ModelError] = Field(default=[])
    theory: Theory | None = None

    @property
    def tried(self) -> list[TriedValue]:
        return [*self.probes]

    @property
    def sign(self) -> int:
        return 1 if self.growth > 0 else -1

    @property
    def covers_patterns(self) -> bool:
        return "guaranteed" in self.model_fields_set

    @property
    def any_pattern(self) -> float | None:
        """Up to where every pattern of delays was kept, or else every tried value."""
        found = self.margin if self.worst_pattern is None else self.worst_pattern.margin
        return found if self.guaranteed is None else self.guaranteed

    @property
    def number(self) -> float | None:
        """The margin to quote; of older results that for all patterns, or the one held."""
        self.require("margin")
        return self.quoted if "quoted" in self.model_fields_set else self.any_pattern

    @property
    def best_known(self) -> float | None:
        """The number to quote; older results have only their margin."""
        return self.quoted if "quoted" in self.model_fields_set else self.margin

    @property
    def because(self) -> str | None:
        """The reason for `quoted`; older results quote what held."""
        return self.quoted_because if "quoted_because" in self.model_fields_set else Because.HELD

    def probe_at(self, value: float | None) -> Probe | None:
        """Return the result at a value that was tried."""
        return next((probe for probe in self.probes if probe.value == value), None)


class MarginResult(CasesResult[MarginCase]):
    """Margins of arms as they are."""

    group = "margin"
    resolution: float = 0.0
    limit: float = 0.0
    offsets: list[float] = Field(default=[1.0])
    arms_with_one_start: list[str] = Field(default=[])

"""Results of studies as ``summary.json`` has them: what all studies have, and several runs.

Values that older versions did not write have a default.
"""

from __future__ import annotations

from typing import Any

from pydantic import Field

from deploy.reports.gauges import GaugedSummary, Part


class Spread(Part):
    """A figure of several runs: mean, lowest and highest; None where no run has it."""

    mean: float | None = None
    lowest: float | None = None
    highest: float | None = None


class Share(Part):
    """A share of plants or runs that kept their bounds, as `share_kept` returns it.

    Attributes:
        kept: how many did.
        total: of how many.
        fraction: the share; None of none.
        wilson_95: Wilson's interval.
        interval_95: that of a sequential test; older results have none.
    """

    kept: int = 0
    total: int = 0
    fraction: float | None = None
    wilson_95: list[float] | None = None
    interval_95: list[float] | None = None

    @property
    def interval(self) -> list[float] | None:
        """The 95 % interval; None where it is not known."""
        return self.interval_95 if "interval_95" in self.model_fields_set else self.wilson_95


class Runs(Share):
    """Several runs of one point or value, as `spread_of_runs` returns them.

    Attributes:
        worst_point: point of the worst run; of uncertain plants those are `worst_points`.
    """

    runs: int
    runs_kept: int
    runs_growing: int = 0
    runs_vibrating: int = 0
    losses: dict[str, int] = Field(default={})
    loss_joints: dict[str, int] = Field(default={})
    runs_failed: int = 0
    not_tested_below_hz: float | None = None
    first_violation_s: Spread | None = None
    violation_fraction: Spread | None = None
    margin_min: Spread | None = None
    worst_rms_rad: Spread | None = None
    worst_total_variation_nm_per_s: Spread | None = None
    worst_point: str = ""
    worst_points: list[str] = Field(default=[])


class StudyResult(GaugedSummary):
    """Parts that the result of every study has.

    Attributes:
        kind: name of its kind.
        name: name of the study.
        runs: number of runs.
        runs_failed: how many left nothing to judge.
        commonest_error: the most frequent error of these.
        seeds: the scenario's seeds.
        conditions: conditions of tables and figures.
        confirmation: the same runs on other physics.
    """

    kind: str = ""
    name: str = ""
    runs: int = 0
    runs_failed: int = 0
    commonest_error: str | None = None
    seeds: list[int] = Field(default=[])
    conditions: dict[str, str] = Field(default={})
    confirmation: Any = None

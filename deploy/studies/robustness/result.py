"""The result of margins over uncertain plants, as ``summary.json`` has it."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from deploy.reports.gauges import Part
from deploy.reports.studies.case_result import CaseResult, CasesResult, TriedValue


class ValueResult(TriedValue):
    """The plants at a value.

    Attributes:
        tolerated: whether enough are kept; None if that is not decided.
        beyond_held_arm_ceiling: number of plants that no law can start at this value.
    """

    tolerated: bool | None = False
    beyond_held_arm_ceiling: int = 0


class Effect(Part):
    """Degree to which a drawn quantity distinguishes lost plants, from −1 to 1."""

    quantity: str
    effect: float


class Losses(Part):
    """Common properties of lost plants; None with too few."""

    lost_plants: int
    kept_plants: int
    chance_level: float | None = None
    effects: list[Effect] | None = None


class RobustCase(CaseResult):
    """A case with the largest value up to which enough plants are kept; None for none."""

    kept_up_to: float | None = None
    values: list[ValueResult] = Field(default=[])
    losses: Losses | None = None

    @property
    def tried(self) -> list[TriedValue]:
        return [*self.values]

    @property
    def number(self) -> float | None:
        self.require("kept_up_to")
        return self.kept_up_to

    @property
    def kept_last(self) -> ValueResult | None:
        """The largest value up to which enough plants are kept."""
        return next((at for at in self.values if at.value == self.kept_up_to), None)


class RobustnessResult(CasesResult[RobustCase]):
    """Margins over uncertain plants.

    Attributes:
        test: the errors with which a sequential test decides; None if all plants were tried.
    """

    group = "robustness"
    values: list[float] = Field(default=[])
    plants: int = 0
    plant_seed: int = 1
    kept_share: float = 0.95
    test: dict[str, Any] | None = None

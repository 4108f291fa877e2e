"""A comparison: the same scenario, plant and seed under several laws, in virtual time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bus_schema.messages import topics
from deploy.comparison.settling import SettlingTest
from deploy.runs.judging.verdict import Verdict, verdict_of
from deploy.runs.run_data import RunData
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.study_keys import (
    LAW,
    UNCERTAINTY,
    laws_beside,
    require_effect,
    require_link_effect,
)
from deploy.scenario.yaml_files import naming, parse_override


def load_setups(scenario: str, overrides: Sequence[str], laws: Sequence[str] | None) -> list[Setup]:
    """The scenario under each law, all checked before any of them runs.

    Args:
        scenario: the scenario.
        overrides: what is set in it.
        laws: which; all shipped ones and the scenario's own if None.

    Raises:
        ScenarioError: anything about it is wrong, such as a law that does not exist.
    """
    with naming(Path("compare")):
        given = dict(map(parse_override, overrides))
        require_effect(given, {LAW: "as --laws", UNCERTAINTY: "to sweep or margin"})
    if laws is None:
        laws = laws_beside(load_setup(scenario, overrides).scenario.controller.law)
    setups = [load_setup(scenario, [*overrides, f"controller.law={law}"]) for law in laws]
    with naming(Path("compare")):
        require_link_effect(given, setups)
    return setups


@dataclass(frozen=True)
class LawRun:
    """The run of one law.

    Attributes:
        law: its name.
        data: the run.
        summary: what `metrics.summarise` says of it.
        path: its folder or MCAP file; None where it was not written.
    """

    law: str
    data: RunData
    summary: dict[str, Any]
    path: Path | None = None

    @property
    def seed(self) -> int:
        return self.data.setup.scenario.seed

    @property
    def verdict(self) -> Verdict:
        """What became of it."""
        return verdict_of(self.summary)

    @property
    def kept_bounds(self) -> bool:
        return self.verdict is Verdict.KEPT


@dataclass(frozen=True)
class Comparison:
    """Runs of one scenario under several laws, in the order asked for.

    Attributes:
        runs: a run for each law.
        settling: what became of starts from near and far, for each law that was put to that test.
    """

    runs: list[LawRun]
    settling: list[SettlingTest] = field(default_factory=list)

    @property
    def drawn(self) -> list[LawRun]:
        """Runs with something to draw."""
        return [run for run in self.runs if len(run.data.tables[topics.PLANT_TRUTH.name]) > 1]

    def colour_index(self, law: str) -> int:
        """Place of a law among all, which gives its colour."""
        return [run.law for run in self.runs].index(law)

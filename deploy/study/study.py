"""Studies: which runs of which scenarios are wanted, and what their rows say together."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from deploy.runs.metrics import summarise
from deploy.runs.run_rows import Row, failed_row, row
from deploy.runs.simulate import attempt
from deploy.scenario.scenario import Setup, load_setup
from deploy.study.definition import StudyDefinition


@dataclass(frozen=True)
class Run:
    """One run of a study.

    Attributes:
        point: name of what was chosen for it, all but the seed; names sort in the order of a study.
        scenario: a scenario file, or the name of a shipped one.
        overrides: what is set in it, as ``dotted.key=value``, but for the seed.
        seed: the scenario's seed.
        columns: what the study varies, by column of its table.
    """

    point: str
    scenario: str
    overrides: tuple[str, ...]
    seed: int
    columns: dict[str, Any]

    @property
    def key(self) -> tuple[str, int]:
        """What tells it from all other runs of its study."""
        return self.point, self.seed


def execute(run: Run) -> Row:
    """Simulate and judge; whatever goes wrong is the row's `error`."""
    try:
        setup = load_setup(run.scenario, [*run.overrides, f"seed={run.seed}"])
        values = row(summarise(attempt(setup).data()), setup.scenario.seed)
    except Exception as error:  # noqa: BLE001 - one bad run must not end a study
        return failed(run, f"{type(error).__name__}: {error}")
    return {"point": run.point, **run.columns, **values}


def failed(run: Run, error: str) -> Row:
    """The row of a run that left nothing to judge."""
    return {"point": run.point, **run.columns, **failed_row(run.seed, error)}


class Study(ABC):
    """A study of a kind.

    It may ask for more runs once it has seen a row, which is how a search works.

    Args:
        values: its definition, as its YAML file has it.
        source: that file, or what to call it in messages; paths of scenarios start beside it.

    Attributes:
        kind: ``sweep`` or ``margin``.
        definition: what to do, with scenarios as `scenario_name` has them.
        columns: names and Parquet types of what it varies.
        bases: the scenarios that it varies.

    Raises:
        ScenarioError: the definition cannot be used, or asks for a scenario that cannot be run.
    """

    kind: ClassVar[str]
    definition: StudyDefinition
    columns: Mapping[str, str]
    bases: list[Setup]

    @abstractmethod
    def __init__(self, values: Mapping[str, Any], source: Path) -> None: ...

    @property
    @abstractmethod
    def expected(self) -> int:
        """How many runs there will be, as far as can be told now."""

    @abstractmethod
    def first(self) -> Iterable[Run]:
        """Runs that are wanted from the beginning."""

    def follow(self, run: Run, values: Row) -> Iterable[Run]:  # noqa: ARG002 (of searches)
        """Runs that are wanted now that a run's row is known."""
        return ()

    @abstractmethod
    def findings(self, rows: list[Row]) -> dict[str, Any]:
        """What came of it, and whether it is `completed`, ready for JSON."""

    def summary(self, rows: list[Row]) -> dict[str, Any]:
        """What came of it, for ``summary.json``.

        Args:
            rows: all rows so far.
        """
        return {
            "kind": self.kind,
            "name": self.definition.name,
            "runs": len(rows),
            "runs_failed": sum(row["error"] is not None for row in rows),
            "seeds": self.definition.seeds,
            **self.findings(rows),
        }

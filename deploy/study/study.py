"""Studies: which runs of which scenarios they request, and summaries of their rows."""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, TypeVar

from deploy.judge.conditions import Conditions, conditions_of_runs, seeds_text
from deploy.judge.gate import Gauged
from deploy.judge.run_rows import Row
from deploy.judge.tested_with import tested_with
from deploy.run.confirmation import CONFIRMATION, confirmations
from deploy.run.run_folder import provenance
from deploy.scenario.checking.warnings import all_warnings
from deploy.scenario.setup import Setup
from deploy.study.definition import StudyDefinition
from deploy.study.execution.growth import Growth, may_rise
from deploy.study.planned_run import PlannedRun
from deploy.study.statistics import commonest_error, seeds_of

OF_BOUND = "% of the bound"
ONE_START = "arms_with_one_start"
"""Key of the findings about arms on which all starts are the same."""


Key = TypeVar("Key")
Value = TypeVar("Value")


def rows_by(rows: Iterable[Value], key: Callable[[Value], Key]) -> dict[Key, list[Value]]:
    """Group rows by a common property, such as their point."""
    found: dict[Key, list[Value]] = {}
    for each in rows:
        found.setdefault(key(each), []).append(each)
    return found


def column_type(values: Iterable[Any]) -> str:
    """Return the Parquet type for all values of a scenario's key."""
    types = {type(value) for value in values}
    if types == {bool}:
        return "bool"
    return "double" if types <= {int, float} else "string"


def digest_of(*contents: bytes) -> str:
    """Return a digest that shows whether a scenario or file has changed."""
    return hashlib.sha256(b"".join(contents)).hexdigest()[:16]


class StudyOfRuns(ABC):
    """Base of all kinds of studies.

    It may request more runs after each row, as a search does.

    Args:
        values: its definition, in the form of its YAML file.
        source: that file, or a name for messages; paths of scenarios start beside it.

    Attributes:
        kind: ``kind`` of its summary, such as ``sweep`` or ``margin``.
        growth: how keys of its definition may change in the same folder, where lists may not just
            get further entries.
        definition: its definition, with scenarios named by `scenario_name`.
        columns: names and Parquet types of varied values.
        bases: the scenarios that it varies.
        files: digests, by path, of files of its runs in addition to those of `bases`.

    Raises:
        ScenarioError: the definition cannot be used, or names a scenario that cannot be run.
    """

    kind: ClassVar[str]
    growth: ClassVar[Mapping[str, Growth]] = MappingProxyType({"plants": may_rise})
    definition: StudyDefinition
    columns: Mapping[str, str]
    bases: list[Setup]
    files: Mapping[str, str] = MappingProxyType({})

    @abstractmethod
    def __init__(self, values: Mapping[str, Any], source: Path) -> None: ...

    @property
    def variants(self) -> list[Setup]:
        """Scenarios in every setting, of which `bases` has one each."""
        return self.bases

    @property
    def laws(self) -> list[str]:
        """Names of the laws of its runs."""
        return list(dict.fromkeys(setup.scenario.controller.name for setup in self.variants))

    @property
    def unit(self) -> str:
        """Of what a gate looks at: the smallest margin to a bound, unless a kind has others."""
        return OF_BOUND

    @property
    def furthest(self) -> Gauged | None:
        """The last value that it tries; None for studies that search for no margin."""
        return None

    @property
    def doubts_before(self) -> list[str]:
        """Reasons, known before any run, why its runs will show no margin."""
        return []

    @property
    def tested_with(self) -> dict[str, dict[str, Any]]:
        """The test of its results, as `deploy.judge.tested_with` describes it."""
        files = {f"file {Path(name).name}": {"digest": each} for name, each in self.files.items()}
        return {**tested_with(self.bases, self.own_test), **files}

    @property
    def own_test(self) -> dict[str, Any]:
        """Values of its definition that belong to the test."""
        return {"seeds": self.definition.seeds}

    @property
    def expected(self) -> int:
        """Number of runs, as far as known now."""
        return self._requested

    @property
    def at_most(self) -> int:
        """Largest number of runs that it can still come to, with those done; it falls over time."""
        return self.expected

    @cached_property
    def _requested(self) -> int:
        return sum(1 for _ in self.first())

    @abstractmethod
    def first(self) -> Iterable[PlannedRun]:
        """Return the runs requested at the beginning."""

    def follow(self, run: PlannedRun, values: Row) -> Iterable[PlannedRun]:  # noqa: ARG002 (of searches)
        """Return the runs requested after a run's row."""
        return ()

    def ahead(self) -> Iterable[PlannedRun]:
        """Return runs that may be requested later, for idle workers."""
        return ()

    def keeps(self, row: Row) -> bool:  # noqa: ARG002 (few do)
        """Whether its folder keeps an earlier row that a complete study has not requested."""
        return False

    @abstractmethod
    def findings(self, rows: list[Row]) -> dict[str, Any]:
        """Return the results, and whether the study is `completed`, ready for JSON."""

    def summary(self, rows: list[Row]) -> dict[str, Any]:
        """Return the results, for ``summary.json``.

        Args:
            rows: all rows so far.
        """
        return {
            "kind": self.kind,
            "name": self.definition.name,
            "runs": len(rows),
            "runs_failed": sum(row["error"] is not None for row in rows),
            "commonest_error": commonest_error(rows),
            "seeds": seeds_of(rows) or self.definition.seeds,
            CONFIRMATION: confirmations(rows),
            **self.findings(rows),
        }

    def recall(self, summary: Mapping[str, Any]) -> None:  # noqa: B027 (few have any)
        """Take over what today's commands cannot find again from the summary of all its rows."""

    def keep_files(self, summary: dict[str, Any], folder: Path) -> None:  # noqa: B027 (few have any)
        """Add files to the folder of the study, and their paths to its summary."""

    def provenance(self) -> dict[str, Any]:
        """Return what was run, with what, and where, for ``manifest.json``."""
        return {**provenance(), "warnings": all_warnings(self.bases)}

    def conditions(self, summary: Mapping[str, Any], manifest: Mapping[str, Any]) -> Conditions:
        """Return the conditions of its tables, figures and rows.

        Args:
            summary: the summary of its rows.
            manifest: ``manifest.json`` of its folder.
        """
        durations = {base.scenario.name: f"{base.scenario.duration_s:g} s" for base in self.bases}
        return {
            "study": " ".join(dict.fromkeys([summary["kind"], summary["name"]])),
            "quantity": _quantity(summary),
            **conditions_of_runs(self.bases, manifest),
            "scenario": ", ".join(durations),
            "law": ", ".join(self.laws),
            "duration": ", ".join(f"{name} {duration}" for name, duration in durations.items()),
            "starts": starts_text(summary),
            "seeds": seeds_text(summary["seeds"]),
            "set": ", ".join(self.definition.fixed_overrides) or "nothing",
        }


def _quantity(summary: Mapping[str, Any]) -> str:
    """Describe the varied quantity, with its unit and resolution."""
    if "axes" in summary:
        return "; ".join(
            f"{', '.join(axis['keys'])} = {', '.join(map(shown_value, axis['values']))}"
            for axis in summary["axes"]
        )
    text = f"{summary['title']} ({summary['unit'] or 'no unit'})"
    if "values" in summary:
        return f"{text} at {', '.join(f'{value:g}' for value in summary['values'])}"
    return f"{text} up to {summary['limit']:g}, found to within {summary['resolution']:g}"


def shown_value(value: Any) -> str:
    """Return a swept value as text; whole numbers without a decimal point."""
    return f"{value:g}" if isinstance(value, float) else str(value)


def starts_text(summary: Mapping[str, Any]) -> str:
    """Describe the starts and plants of a study, and which starts are all the same."""
    offsets = summary.get("offsets", [1.0])
    text = "initial offset × " + ", ".join(f"{offset:g}" for offset in offsets)
    if arms := summary.get(ONE_START):
        text += f"; once on {', '.join(arms)}, where the initial offset is 0"
    if summary.get("plants") is None:
        return text
    return f"{text}; {summary['plants']} plants of plant_seed {summary['plant_seed']}"

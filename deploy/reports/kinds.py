"""Kinds of results: what a gate reads in each, how it is drawn, listed and evaluated again.

`kind_of` is the only place that looks up a summary's ``kind``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import TypeAdapter, ValidationError

from bus_schema.configuration import ConfigurationError
from bus_schema.registry import Registry
from bus_schema.user_files import read_text
from deploy.judge.gate import Gauged
from deploy.judge.verdict import verdict_of
from deploy.reports.gauges import GaugedRun, GaugedSummary
from deploy.reports.shipped_kinds import COMMANDS, WITHOUT_COMMAND
from deploy.scenario.yaml_files import ScenarioError

if TYPE_CHECKING:
    from deploy.reports.figures.study_figures import DrawnStudy
    from deploy.reports.page import Page
    from deploy.reports.results import Again, Results
    from deploy.study.execution.folder import StudyFolder
    from deploy.study.study import StudyOfRuns

Summary = Mapping[str, Any]

OLDER, COMPLETE = "older version", "complete"
_JSON = TypeAdapter(dict[str, Any])
_ALLOWED = "must be summary.json of a finished run or study, or its folder"


def run_verdict(summary: Summary) -> str:
    """Return the verdict in a summary; older versions did not write it there."""
    is_older = "ticks" in summary and "verdict" not in summary
    return OLDER if is_older else verdict_of(summary).listed


def completeness(summary: Summary) -> str:
    """Return ``complete``, or the verdict in a summary."""
    return COMPLETE if summary.get("completed") else run_verdict(summary)


@dataclass(frozen=True)
class ResultKind:
    """A kind of result: its study, its page and its numbers.

    Attributes:
        name: ``kind`` in its summary.
        gauged: the numbers that a gate reads; None if it has none.
        study: the class of its studies; None if it is no study.
        page: makes the page of a study from its summary; None if recordings are judged.
        judged: judges the recordings in the folder of a study, from its summary; None without any.
        again: judges it again; None for one recording, and for the rows of a study.
        listed: returns its result in a list: a verdict, or ``complete``.
        is_run: whether it is a single run.
    """

    name: str
    gauged: type[GaugedSummary] | None = None
    study: type[StudyOfRuns] | None = None
    page: Callable[[DrawnStudy], Page[DrawnStudy]] | None = None
    judged: Callable[[StudyFolder, dict[str, Any]], Results] | None = None
    again: Callable[[Path], Again] | None = None
    listed: Callable[[Summary], str] = completeness
    is_run: bool = False

    def unit_for(self, asked: str, unit: str) -> str:
        """Return the unit of the numbers that a gate reads.

        Args:
            asked: unit of its limit; empty for none.
            unit: of the numbers that it reads otherwise.
        """
        return asked if asked in self.units(unit) else unit

    def units(self, unit: str) -> list[str]:
        """Return the units of all numbers that a gate can read, beginning with the usual one."""
        return [unit, *(() if self.gauged is None else self.gauged.other_units)]

    def compared_with(self, quantity: str | None, *, patterns: bool = False) -> str:
        """Return what its results can be compared with, as `GaugedSummary.compared_with`."""
        return "" if self.gauged is None else self.gauged.compared_with(quantity, patterns=patterns)


_SHIPPED = {
    **{name: f"deploy.studies.{name}.kind:KIND" for name in (*COMMANDS, *WITHOUT_COMMAND)},
    "robot_datasheet": "deploy.studies.datasheet.kind:ROBOT",
}
"""Where what ships is, in the form of an entry point: each package of `deploy.studies` has one."""

RESULT_KINDS: Registry[ResultKind] = Registry(
    "studies", "kind", ResultKind,
    {"run": ResultKind("run", GaugedRun, listed=run_verdict, is_run=True), **_SHIPPED},
)  # fmt: skip
"""Kinds of results by name; installed packages add kinds of study."""


def kind_of(summary: Summary) -> ResultKind:
    """Return the kind of a ``summary.json``, that of a run if it names none."""
    return kind_named(str(summary.get("kind", "run")))


def kind_named(name: str) -> ResultKind:
    """Return a kind by its name; unknown ones, and unusable ones, have no numbers and no page."""
    with suppress(ConfigurationError):
        return RESULT_KINDS[name]
    return ResultKind(name)


def study_type(name: str) -> type[StudyOfRuns]:
    """Return the class of the studies of a kind.

    Raises:
        ConfigurationError: there is no such kind, or it is no study.
    """
    found = RESULT_KINDS[name].study
    if found is None:
        raise ConfigurationError(RESULT_KINDS.key, name, "must be a kind of study")
    return found


def gauged(summary: Summary, unit: str | None = None) -> list[Gauged]:
    """Return the numbers of a ``summary.json``.

    Args:
        summary: the result.
        unit: of the wanted numbers, if others have `GaugedSummary.other_units`; None for those in
            none of these units.

    Raises:
        ValueError: its kind has none, or one is missing.
    """
    return numbers_in(_read(summary), unit)


def numbers_in(found: GaugedSummary, unit: str | None) -> list[Gauged]:
    """Return the numbers of a result in a unit, as `gauged` takes it."""
    if unit in found.other_units:
        return [each for each in found.numbers() if each.unit == unit]
    return [each for each in found.numbers() if each.unit not in found.other_units]


def read_baseline(path: Path, unit: str) -> GaugedSummary:
    """Return an earlier result, which has numbers in a unit.

    Args:
        path: its ``summary.json``, or its folder.
        unit: of the numbers, as `gauged` takes it.

    Raises:
        ScenarioError: it cannot be read, is of another kind, unfinished, or lacks a number.
    """
    file = path / "summary.json" if path.is_dir() else path
    try:
        found = _read(_JSON.validate_json(read_text(file)))
        numbers_in(found, unit)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        reason = f"{place}: {first['msg']}" if place else first["msg"]
        raise ScenarioError(f"--baseline {file}: {reason}: {_ALLOWED}") from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ScenarioError(f"--baseline {file}: {reason}: {_ALLOWED}") from error
    if not found.completed:
        raise ScenarioError(f"--baseline {file}: is unfinished (completed = false): {_ALLOWED}")
    return found


def require_numbers(path: Path, found: GaugedSummary, unit: str) -> None:
    """Check that an earlier result of the right kind has numbers in a unit; older ones lack some.

    Raises:
        ScenarioError: it has none.
    """
    if unit in found.other_units and not numbers_in(found, unit):
        raise ScenarioError(f"--baseline {path}: has no number in {unit}: {_ALLOWED}")


def _read(summary: Summary) -> GaugedSummary:
    kind = kind_of(summary)
    if kind.gauged is None:
        raise ValueError(f"kind {kind.name[:40]!r}: has no numbers for a gate")
    return kind.gauged.model_validate(summary)

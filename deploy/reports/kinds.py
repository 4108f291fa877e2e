"""Kinds of results: what a gate reads in each, how it is drawn, listed and evaluated again.

`kind_of` is the only place that looks up a summary's ``kind``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

from pydantic import TypeAdapter, ValidationError

from bus_schema.configuration import ConfigurationError
from bus_schema.registry import Registry
from bus_schema.user_files import read_text
from deploy.judge.gate import Gauged
from deploy.judge.verdict import Verdict, verdict_of
from deploy.reports.gauges import (
    GaugedBenchmark,
    GaugedComparison,
    GaugedDataSheet,
    GaugedMargins,
    GaugedRobotSheet,
    GaugedRobustness,
    GaugedRun,
    GaugedSummary,
    GaugedSweep,
    GaugedTuning,
)
from deploy.reports.studies.study_tables import margins_by_law, robustness_table
from deploy.reports.tables import Table
from deploy.scenario.yaml_files import ScenarioError

if TYPE_CHECKING:
    from deploy.reports.again import Again
    from deploy.reports.figures.study_figures import DrawnStudy
    from deploy.reports.page import Page
    from deploy.study.study import StudyOfRuns

Summary = Mapping[str, Any]

_OLDER, _COMPLETE = "older version", "complete"
_WORST = (
    _OLDER,
    *(each.listed for each in (Verdict.INTERRUPTED, Verdict.NOTHING, Verdict.FAULTED)),
)
_JSON = TypeAdapter(dict[str, Any])
_ALLOWED = "must be summary.json of a finished run or study, or its folder"


def _verdict(summary: Summary) -> str:
    """Return the verdict in a summary; older versions did not write it there."""
    is_older = "ticks" in summary and "verdict" not in summary
    return _OLDER if is_older else verdict_of(summary).listed


def _completeness(summary: Summary) -> str:
    return _COMPLETE if summary.get("completed") else _verdict(summary)


def _worst_law(summary: Summary) -> str:
    laws = summary.get("laws")
    if not isinstance(laws, dict):
        return _completeness(summary)
    found = {_verdict(law) for law in laws.values() if isinstance(law, dict)}
    return next((each for each in _WORST if each in found), _COMPLETE)


@dataclass(frozen=True)
class ResultKind:
    """A kind of result: its page and its numbers.

    What is heavy to import is named as ``module:name``, and imported when it is first needed.

    Attributes:
        name: ``kind`` in its summary.
        gauged: the numbers that a gate reads; None if it has none.
        quoted: returns the table for documents; None if it has none.
        listed: returns its result in a list: a verdict, or ``complete``.
        is_run: whether it is a single run.
        page_at: place of `page`; empty for None, as with the next two.
        study_at: place of `study`.
        again_at: place of `again`.
    """

    name: str
    gauged: type[GaugedSummary] | None = None
    quoted: Callable[[dict[str, Any]], Table] | None = None
    listed: Callable[[Summary], str] = _completeness
    is_run: bool = False
    page_at: str = ""
    study_at: str = ""
    again_at: str = ""

    @property
    def page(self) -> Callable[[DrawnStudy], Page[DrawnStudy]] | None:
        """Return what makes the page of a study from its summary; None if recordings are judged."""
        found: Callable[[DrawnStudy], Page[DrawnStudy]] | None = _at(self.page_at)
        return found

    @property
    def study(self) -> type[StudyOfRuns] | None:
        """Return the class of its studies; None if it is no study."""
        found: type[StudyOfRuns] | None = _at(self.study_at)
        return found

    @property
    def again(self) -> Callable[[Path], Again] | None:
        """Return what judges it again; None for one recording, and for the rows of a study."""
        found: Callable[[Path], Again] | None = _at(self.again_at)
        return found

    def unit_for(self, asked: str, unit: str) -> str:
        """Return the unit of the numbers that a gate reads.

        Args:
            asked: unit of its limit; empty for none.
            unit: of the numbers that it reads otherwise.
        """
        others = () if self.gauged is None else self.gauged.other_units
        return asked if asked in others else unit

    def compared_with(self, quantity: str | None, *, patterns: bool = False) -> str:
        """Return what its results can be compared with, as `GaugedSummary.compared_with`."""
        return "" if self.gauged is None else self.gauged.compared_with(quantity, patterns=patterns)


def _at(place: str) -> Any:
    """Import what is at ``module:name``; None if the place is empty."""
    return resolve_name(place) if place else None


RESULT_KINDS: Registry[ResultKind] = Registry("studies", "kind", ResultKind, {
    kind.name: kind
    for kind in (
        ResultKind("run", GaugedRun, listed=_verdict, is_run=True),
        ResultKind("comparison", GaugedComparison, listed=_worst_law,
                   study_at="deploy.study.comparison.comparison:LawComparison",
                   again_at="deploy.reports.again:laws_again"),
        ResultKind("diff", again_at="deploy.reports.again:diff_again"),
        ResultKind("sweep", GaugedSweep, page_at="deploy.reports.studies.sweep_page:sweep_page",
                   study_at="deploy.study.sweep:Sweep"),
        ResultKind("margin", GaugedMargins, margins_by_law,
                   page_at="deploy.reports.studies.margin_pages:margin_page",
                   study_at="deploy.study.margin:Margin"),
        ResultKind("robustness", GaugedRobustness, robustness_table,
                   page_at="deploy.reports.studies.margin_pages:robustness_page",
                   study_at="deploy.study.robustness:Robustness"),
        ResultKind("tune", GaugedTuning, page_at="deploy.reports.studies.tune_page:tune_page",
                   study_at="deploy.study.tuning.tuning:Tuning"),
        ResultKind("benchmark", GaugedBenchmark,
                   page_at="deploy.reports.studies.benchmark_page:benchmark_page",
                   study_at="deploy.study.benchmark.benchmark:Benchmark"),
        ResultKind("datasheet", GaugedDataSheet,
                   again_at="deploy.reports.studies.data_sheet_results:sheet_again"),
        ResultKind("robot_datasheet", GaugedRobotSheet,
                   again_at="deploy.reports.studies.robot_sheet_results:robot_sheet_again"),
    )
})  # fmt: skip
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

"""The numbers of a result that a gate looks at, and what a result must be to have them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, TypeAdapter, ValidationError

from bus_schema.user_files import read_text
from deploy.judge.verdict import Verdict
from deploy.reports.study_texts import case_title
from deploy.scenario.yaml_files import ScenarioError
from deploy.study.study import OF_BOUND, shown_value

_EVERY_PATTERN = ", every pattern of delays"
RUNS = "runs"
"""What runs and comparisons are compared as."""
Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]


@dataclass(frozen=True)
class Gauged:
    """One number of a result.

    Attributes:
        name: of what it is the number: an arm, a law, a point of a sweep.
        value: None if even the easiest case was lost.
        unit: of the value; empty if it has none.
        sign: 1 if larger values are better, -1 if smaller ones are.
        doubt: why the value was not tested, empty if it was.
    """

    name: str
    value: float | None
    unit: str
    sign: int = 1
    doubt: str = ""

    @property
    def text(self) -> str:
        if self.value is None:
            return "none"
        return f"{self.value:.4g} {self.unit}".rstrip()

    def is_below(self, limit: float) -> bool:
        """Whether it does not reach a limit; NaN reaches none."""
        return self.value is None or not self.sign * (self.value - limit) >= 0


class _Part(BaseModel):
    """A part of a ``summary.json``; it may have more keys."""

    model_config = ConfigDict(strict=True, allow_inf_nan=False, extra="allow")


class _Bounds(_Part):
    margin_min: Finite | None


class _Run(_Part):
    completed: bool = True
    scenario: str
    law: str
    verdict: str
    bounds: _Bounds

    def numbers(self) -> Iterator[Gauged]:
        margin = self.bounds.margin_min if self.verdict == Verdict.KEPT else None
        yield _of_bound(f"{self.scenario}, {self.law}", margin)


class _Comparison(_Part):
    completed: bool = True
    laws: Annotated[dict[str, _Run], Field(min_length=1)]

    def numbers(self) -> Iterator[Gauged]:
        for run in self.laws.values():
            yield from run.numbers()


class _Axis(_Part):
    keys: list[str]


class _Lowest(_Part):
    lowest: Finite | None


class _Point(_Part):
    values: list[Any]
    runs: int
    runs_kept: int
    margin_min: _Lowest


class _Sweep(_Part):
    completed: bool = True
    axes: list[_Axis]
    points: Annotated[list[_Point], Field(min_length=1)]

    def numbers(self) -> Iterator[Gauged]:
        for point in self.points:
            if len(point.values) != len(self.axes):
                raise ValueError("points: values: must be one for each of axes")
            values = zip(self.axes, point.values, strict=True)
            name = ", ".join(f"{', '.join(axis.keys)} = {shown_value(v)}" for axis, v in values)
            is_kept = point.runs_kept == point.runs
            yield _of_bound(name, point.margin_min.lowest if is_kept else None)


class _Worst(_Part):
    margin: Finite


class _Case(_Part):
    arm: str
    law: str
    compensation: bool | None
    drive_feedback: bool | None
    running: bool
    growth: Finite = 1
    margin: Finite | None = None
    kept_up_to: Finite | None = None
    guaranteed: Finite | None = None
    worst_pattern: _Worst | None = None
    doubts: list[str] = []

    @property
    def covers_patterns(self) -> bool:
        """Whether delays that vary were tried too."""
        return "guaranteed" in self.model_fields_set

    @property
    def least_margin(self) -> float | None:
        """The margin; with patterns the one for all of them: guaranteed, or where all held."""
        found = self.margin if self.worst_pattern is None else self.worst_pattern.margin
        return found if self.guaranteed is None else self.guaranteed


class _Margin(_Part):
    kind: Literal["margin", "robustness"]
    completed: bool = True
    quantity: str = "delay"
    unit: str | None
    cases: Annotated[list[_Case], Field(min_length=1)]

    def numbers(self) -> Iterator[Gauged]:
        key = "margin" if self.kind == "margin" else "kept_up_to"
        for case in self.cases:
            if key not in case.model_fields_set:
                raise ValueError(f"cases: {case.arm}: {key} is missing")
            sign = 1 if case.growth > 0 else -1
            name, doubt = case_title(case.model_dump()), "; ".join(case.doubts)
            name += _EVERY_PATTERN if case.covers_patterns else ""
            value = case.least_margin if key == "margin" else case.kept_up_to
            yield Gauged(name, value, self.unit or "", sign, doubt)


class _Tuning(_Part):
    kind: Literal["tune"]
    completed: bool = True

    def numbers(self) -> Iterator[Gauged]:
        return iter(())  # its costs are for searches alone


_RESULT: TypeAdapter[_Run | _Comparison | _Sweep | _Margin | _Tuning] = TypeAdapter(
    Annotated[
        Annotated[_Run, Tag("run")]
        | Annotated[_Comparison, Tag("comparison")]
        | Annotated[_Sweep, Tag("sweep")]
        | Annotated[_Margin, Tag("margin")]
        | Annotated[_Margin, Tag("robustness")]
        | Annotated[_Tuning, Tag("tune")],
        Discriminator(lambda values: values.get("kind", "run")),
    ]
)


def _of_bound(name: str, margin: float | None) -> Gauged:
    return Gauged(name, None if margin is None else 100.0 * margin, OF_BOUND)


def gauged(summary: Mapping[str, Any]) -> list[Gauged]:
    """The numbers of a ``summary.json``.

    Raises:
        ValueError: it is of another kind, or lacks a number.
    """
    return list(_RESULT.validate_python(summary).numbers())


def compared_as(kind: str, quantity: str | None, *, patterns: bool = False) -> str:
    """What results are compared with each other: of one kind, and margins of one quantity.

    Args:
        kind: of the result.
        quantity: of which it has margins.
        patterns: whether these are for every pattern of delays.
    """
    if quantity:
        return f"{kind} of {quantity}{_EVERY_PATTERN if patterns else ''}"
    return RUNS if kind in ("run", "comparison") else kind


def read_baseline(path: Path) -> tuple[str, list[Gauged]]:
    """What an earlier result is compared as, and its numbers.

    Args:
        path: its ``summary.json``, or its folder.

    Raises:
        ScenarioError: it cannot be read, is of another kind, unfinished, or has no numbers.
    """
    file = path / "summary.json" if path.is_dir() else path
    try:
        found = _RESULT.validate_json(read_text(file))
        numbers = list(found.numbers())
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        reason = f"{place}: {first['msg']}" if place else first["msg"]
        raise ScenarioError(f"--baseline {file}: {reason}: {_ALLOWED}") from error
    except (OSError, ValueError, AttributeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ScenarioError(f"--baseline {file}: {reason}: {_ALLOWED}") from error
    if not found.completed:
        raise ScenarioError(f"--baseline {file}: is unfinished (completed = false): {_ALLOWED}")
    if isinstance(found, _Margin):
        patterns = any(case.covers_patterns for case in found.cases)
        return compared_as(found.kind, found.quantity, patterns=patterns), numbers
    return compared_as("sweep" if isinstance(found, _Sweep) else RUNS, None), numbers


_ALLOWED = "must be summary.json of a finished run or study, or its folder"

"""The numbers in a summary that a gate reads."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import Any, ClassVar, get_args

from pydantic import BaseModel, ConfigDict, model_validator

from deploy.judge.gate import Finite, Gauged
from deploy.judge.verdict import Verdict
from deploy.study.study import OF_BOUND

EVERY_PATTERN = ", every pattern of delays"
TO_QUOTE = ", margin to quote"
_RUNS, MM, _MS, JERK = "runs", "mm", "ms", "rad/s3"


class Part(BaseModel):
    """A part of a ``summary.json``; it may have more keys.

    Null stands for the default of a key that allows no null: what was not tried yet, as of an
    unfinished result.
    """

    model_config = ConfigDict(strict=True, allow_inf_nan=False, extra="allow", defer_build=True)

    @model_validator(mode="before")
    @classmethod
    def _without_nulls(cls, given: Any) -> Any:
        if not isinstance(given, dict):
            return given
        return {
            key: each for key, each in given.items() if each is not None or cls._may_be_null(key)
        }

    def to_json(self) -> dict[str, Any]:
        """Return its content for ``summary.json``: what was set."""
        return self.model_dump(exclude_unset=True)

    @classmethod
    def _may_be_null(cls, key: str) -> bool:
        field = cls.model_fields.get(key)
        if field is None or field.is_required():
            return True
        return field.annotation is Any or type(None) in get_args(field.annotation)


class GaugedSummary(Part, ABC):
    """The part of a summary that a gate reads.

    Attributes:
        group: name of the results that can be compared with these.
        other_units: of numbers that a gate reads only if its limit has this unit.
        completed: whether the results are complete.
        tested_with: the test behind the results; None if an older version made them.
    """

    group: ClassVar[str] = _RUNS
    other_units: ClassVar[tuple[str, ...]] = ()
    completed: bool = True
    tested_with: dict[str, dict[str, Any]] | None = None

    @abstractmethod
    def numbers(self) -> Iterator[Gauged]:
        """Return the numbers; raises `ValueError` if one is missing."""

    @property
    def compared_as(self) -> str:
        """Quantity by which these results can be compared, as by `compared_with`."""
        return self.group

    @classmethod
    def compared_with(cls, quantity: str | None, *, patterns: bool) -> str:
        """Return what can be compared: results of one group, and margins of one quantity.

        Args:
            quantity: quantity of the margins, if there are any.
            patterns: whether they are for every pattern of delays.
        """
        if quantity:
            return f"{cls.group} of {quantity}{EVERY_PATTERN if patterns else ''}"
        return cls.group


class _Bounds(Part):
    margin_min: Finite | None


class _TipError(Part):
    largest: Finite | None


class _Chunks(Part):
    jump_mm: Finite | None = None
    jerk_rad_s3: Finite | None = None


class GaugedRun(GaugedSummary):
    """A run: its smallest margin, the largest error of its tip, and its largest lag.

    A run of a law slower than its loop also has the largest jump and jerk of its targets.
    """

    other_units = (MM, _MS, JERK)
    scenario: str
    law: str
    verdict: str
    bounds: _Bounds
    tip_error_mm: _TipError | None = None
    lag_ms: list[Finite | None] | None = None
    chunks: _Chunks | None = None

    def numbers(self) -> Iterator[Gauged]:
        is_kept = self.verdict == Verdict.KEPT
        name = f"{self.scenario}, {self.law}"
        yield of_bound(name, self.bounds.margin_min if is_kept else None)
        if self.tip_error_mm is not None:  # which older versions lack
            largest = self.tip_error_mm.largest if is_kept else None
            yield Gauged(f"{name}, largest tip error", largest, MM, sign=-1)
        if self.lag_ms is not None:
            lags = [abs(lag) for lag in self.lag_ms if lag is not None and is_kept]
            yield Gauged(f"{name}, largest lag", max(lags, default=None), _MS, sign=-1)
        if self.chunks is not None:
            of_targets = (
                ("jump", self.chunks.jump_mm, MM),
                ("jerk", self.chunks.jerk_rad_s3, JERK),
            )
            for what, size, unit in of_targets:
                if size is not None:
                    largest = size if is_kept else None
                    yield Gauged(f"{name}, largest {what} of targets", largest, unit, sign=-1)


def of_bound(name: str, margin: float | None) -> Gauged:
    """Return a margin as a share of its bound."""
    return Gauged(name, None if margin is None else 100.0 * margin, OF_BOUND)

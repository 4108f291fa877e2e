"""A gate: which numbers of a result are too small, or smaller than before.

A study of margins is gated by each margin; a sweep, comparison or run by the smallest distance of
an error to its bound, in percent of the bound; with a limit in mm or ms a comparison or run by the
largest error of the tip, or by the largest lag of a joint. A history holds the numbers of earlier
commits.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import subprocess
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from pydantic import Field, TypeAdapter, ValidationError

from bus_schema.configuration import shown
from bus_schema.user_files import read_text
from deploy.scenario.yaml_files import ScenarioError

Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]
ENTRIES = "history.jsonl"
"""File of a history, a line for each entry."""
_PERCENT = "%"
_SIZE = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+))\s*(\S*)\s*")


@dataclass(frozen=True)
class Entry:
    """The result of a commit, and its numbers by name."""

    commit: str
    time: str
    values: dict[str, Finite | None]


ENTRY = TypeAdapter(Entry)


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
            return "none" if self.sign > 0 else "bounds not kept"
        return f"{self.value:.4g} {self.unit}".rstrip()

    def is_below(self, limit: float) -> bool:
        """Whether it does not reach a limit; NaN reaches none."""
        return self.value is None or not self.sign * (self.value - limit) >= 0


@dataclass(frozen=True)
class Gate:
    """Thresholds that the numbers of a result must reach.

    Attributes:
        at_least: the smallest allowed value; None for any.
        baseline: numbers of an earlier result, by name.
        tolerance: by how much a number may be worse than the earlier one.
        is_relative: whether the tolerance is in percent of the earlier number.
        unit: of `at_least` and `tolerance` as given; empty if none was given.
        compared_as: what the earlier result is compared as; empty without one.
    """

    at_least: float | None = None
    baseline: Mapping[str, Gauged] = field(default_factory=dict)
    tolerance: float = 0.0
    is_relative: bool = False
    unit: str = ""
    compared_as: str = ""

    @property
    def is_given(self) -> bool:
        """Whether it can fail."""
        return self.at_least is not None or bool(self.baseline)

    def failures(self, found: Sequence[Gauged]) -> dict[str, str]:
        """A sentence for each number that fell too low, by its name."""
        sentences = {each.name: self._failure(each) for each in found}
        names = {each.name for each in found}
        missing = {name: f"{name}: is missing" for name in self.baseline if name not in names}
        return {name: failure for name, failure in sentences.items() if failure} | missing

    def _failure(self, found: Gauged) -> str:
        """Explain why a number fell too low, or was not tested; empty if neither."""
        if found.doubt and self.is_given:
            return f"{found.name}: {found.text}, not tested: {found.doubt}"
        if self.at_least is not None and found.is_below(self.at_least):
            word = "at least" if found.sign > 0 else "at most"
            limit = f"{self.at_least:g} {found.unit}".rstrip()
            return f"{found.name}: {found.text}, must be {word} {limit}"
        before = self.baseline.get(found.name)
        if before is None or before.value is None:
            return ""
        share = abs(before.value) / 100.0 if self.is_relative else 1.0
        if not found.is_below(before.value - before.sign * self.tolerance * share):
            return ""
        by = "" if found.value is None else f" by {abs(before.value - found.value):.4g}"
        unit = _PERCENT if self.is_relative else found.unit
        allowed = f"{self.tolerance:g} {unit}".rstrip()
        moved = "fell" if found.sign > 0 else "rose"
        return (
            f"{found.name}: {moved}{by} from {before.text} to {found.text}, more than the {allowed}"
            " allowed"
        )


def build_gate(
    at_least: str | None, tolerance: str | None, baseline: tuple[str, list[Gauged]] | None = None
) -> Gate:
    """Return the gate of a command's options.

    Args:
        at_least: the smallest allowed value, such as ``20ms``; None for any.
        tolerance: how much worse than the baseline a number may be, or by which share of it; None
            for 0. For numbers that are in percent themselves, it is in the same percent.
        baseline: kind and numbers of an earlier result.

    Raises:
        ScenarioError: a number cannot be read.
    """
    if tolerance is not None and baseline is None:
        raise ScenarioError(f"--tolerance {tolerance}: needs --baseline")
    limit, unit = _size("--at-least", at_least)
    allowed, other = _size("--tolerance", tolerance)
    kind, found = ("", []) if baseline is None else baseline
    is_in_percent = any(each.unit.startswith(_PERCENT) for each in found)
    is_relative = other == _PERCENT and not is_in_percent
    other = "" if is_relative else other
    if unit and other and unit != other:
        raise ScenarioError(
            f"--tolerance {tolerance}: must have the unit of --at-least, {unit}, or be in % of the"
            " earlier number"
        )
    if allowed is not None and not allowed >= 0.0:
        raise ScenarioError(f"--tolerance {tolerance}: must be 0 or more")
    named = {each.name: each for each in found}
    return Gate(limit, named, allowed or 0.0, is_relative, unit or other, kind)


def unit_of(at_least: str | None, tolerance: str | None) -> str:
    """Return the unit of the options of a gate; empty if they have none.

    Raises:
        ScenarioError: a number cannot be read.
    """
    return _size("--at-least", at_least)[1] or _size("--tolerance", tolerance)[1]


def require_units(at_least: str | None, tolerance: str | None, units: Sequence[str]) -> None:
    """Check that the options of a gate have a unit where the numbers have one.

    Args:
        at_least: the smallest allowed value as given.
        tolerance: the tolerance as given.
        units: units of the numbers that a gate can read; empty for none.

    Raises:
        ScenarioError: a number other than 0 has no unit.
    """
    words = [unit.partition(" ")[0] for unit in units if unit]
    of_share = [] if _PERCENT in words else [_PERCENT]
    for option, text, more in (("--at-least", at_least, []), ("--tolerance", tolerance, of_share)):
        number, unit = _size(option, text)
        if number and words and not unit:
            texts = [f"{number:g}{each}" for each in (*words, *more)]
            raise ScenarioError(f"{option} {text}: must have a unit: write {' or '.join(texts)}")


def require_fit(gate: Gate, unit: str, kind: str) -> None:
    """Check that a gate's numbers are of the unit and kind of a result.

    Raises:
        ScenarioError: they, or those of the baseline, are not.
    """
    if gate.compared_as not in ("", kind):
        raise ScenarioError(f"--baseline: is a result of {gate.compared_as}: must be of {kind}")
    if gate.unit and gate.unit != unit.partition(" ")[0]:
        raise ScenarioError(
            f"--at-least or --tolerance: unit {shown(gate.unit)}: must be"
            f" {unit.partition(' ')[0] or 'left out'}, because the result is in"
            f" {unit or 'no unit'}"
        )
    for each in gate.baseline.values():
        if each.unit != unit:
            raise ScenarioError(
                f"--baseline: {each.name} is in {each.unit or 'no unit'}: must be a result in"
                f" {unit or 'no unit'}"
            )


def require_reach(gate: Gate, furthest: Gauged | None) -> None:
    """Check that a search tries values up to the smallest allowed one.

    Args:
        gate: the gate.
        furthest: the last value that is tried, named after where it is set; None for any.

    Raises:
        ScenarioError: it does not, so that no result can pass.
    """
    if furthest is None or gate.at_least is None or gate.unit not in ("", furthest.unit):
        return
    if furthest.is_below(gate.at_least):
        least = f"{gate.at_least:g} {furthest.unit}".rstrip()
        word = "most" if furthest.sign > 0 else "least"
        raise ScenarioError(
            f"--at-least {least}: must be at {word} {furthest.text}, {furthest.name}: no result"
            " can pass"
        )


def _size(option: str, text: str | None) -> tuple[float | None, str]:
    """A number and its unit from ``20ms``."""
    if text is None:
        return None, ""
    found = _SIZE.fullmatch(text)
    if found is None:
        raise ScenarioError(f"{option} {shown(text)}: must be a number with its unit, such as 20ms")
    return float(found[1]), found[2]


def read_history(folder: Path) -> list[Entry]:
    """Return earlier results, the oldest first.

    Raises:
        ScenarioError: there is no folder of this name, but a file; or a line of ``history.jsonl``
            is not one of ours.
    """
    if folder.exists() and not folder.is_dir():
        raise ScenarioError(f"--history {folder}: must be a folder")
    file, entries = folder / ENTRIES, []
    try:
        lines = read_text(file).splitlines() if file.exists() else []
    except OSError as error:
        raise ScenarioError(f"{file}: {error.strerror or error}") from error
    for number, line in enumerate(lines, 1):
        try:
            entries.append(ENTRY.validate_json(line))
        except ValidationError as error:
            raise ScenarioError(
                f"{file}, line {number}: must be an entry of this history (commit, time, values)"
            ) from error
    return entries


@contextlib.contextmanager
def locked_history(folder: Path) -> Iterator[list[Entry]]:
    """Return earlier results, and make other commands wait while the context lasts.

    Raises:
        ScenarioError: as for `read_history`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "history.lock").open("a") as lock:
        with contextlib.suppress(OSError):  # a file system without locks
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield read_history(folder)


def entry_of(found: Sequence[Gauged]) -> Entry:
    """The entry of a result at this commit."""
    values = {each.name: each.value for each in found}
    return Entry(_commit(), time.strftime("%Y-%m-%dT%H:%M:%S%z"), values)


def since_when(entries: Sequence[Entry], gauge: Gauged) -> str:
    """Return a number's last better value, and the commit at which it fell; empty if never."""
    fell = ""
    for entry in reversed(entries):
        value = entry.values.get(gauge.name)
        if value is not None and (gauge.value is None or gauge.is_below(value)):
            return f"; it was {value:.4g} at {entry.commit}, and fell at {fell or _commit()}"
        fell = entry.commit
    return ""


def _commit() -> str:
    """The commit that is tested: of the CI service, or of the folder; "unknown" without."""
    if sha := os.environ.get("GITHUB_SHA") or os.environ.get("CI_COMMIT_SHA"):
        return sha[:8]
    command = ["git", "rev-parse", "--short=8", "HEAD"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=5)
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return done.stdout.strip()

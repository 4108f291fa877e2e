"""A gate: the numbers of a result that must not be small, or smaller than before.

A study of margins is gated by each margin, a sweep, comparison or run by the smallest distance of
an error to its bound, in percent of the bound.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bus_schema.configuration import shown
from deploy.judge.verdict import Verdict
from deploy.reports.study_texts import case_name, shown_value
from deploy.run.run_folder import read_json
from deploy.scenario.yaml_files import ScenarioError
from deploy.study.study import OF_BOUND

_SIZE = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+))\s*(\S*)\s*")


@dataclass(frozen=True)
class Gauged:
    """One number of a result.

    Attributes:
        name: of what it is the number: an arm, a law, a point of a sweep.
        value: None if even the easiest case was lost.
        unit: of the value; empty if it has none.
        sign: 1 if larger values are better, -1 if smaller ones are.
    """

    name: str
    value: float | None
    unit: str
    sign: int = 1

    @property
    def text(self) -> str:
        if self.value is None:
            return "none"
        return f"{self.value:.4g} {self.unit}".rstrip()

    def is_below(self, limit: float) -> bool:
        """Whether it does not reach a limit."""
        return self.value is None or self.sign * (self.value - limit) < 0


@dataclass(frozen=True)
class Gate:
    """What the numbers of a result must reach.

    Attributes:
        at_least: the smallest allowed value; None for any.
        baseline: numbers of an earlier result, by name.
        tolerance: by how much a number may be worse than the earlier one.
        unit: of `at_least` and `tolerance` as given; empty if none was given.
    """

    at_least: float | None = None
    baseline: Mapping[str, Gauged] = field(default_factory=dict)
    tolerance: float = 0.0
    unit: str = ""

    def failures(self, found: Sequence[Gauged]) -> dict[str, str]:
        """A sentence for each number that fell too low, by its name."""
        sentences = {each.name: self._failure(each) for each in found}
        names = {each.name for each in found}
        missing = {name: f"{name}: is missing" for name in self.baseline if name not in names}
        return {name: said for name, said in sentences.items() if said} | missing

    def _failure(self, found: Gauged) -> str:
        """Why a number fell too low; empty if it did not."""
        if self.at_least is not None and found.is_below(self.at_least):
            word = "at least" if found.sign > 0 else "at most"
            limit = f"{self.at_least:g} {found.unit}".rstrip()
            return f"{found.name}: {found.text}, must be {word} {limit}"
        before = self.baseline.get(found.name)
        if before is None or before.value is None:
            return ""
        if not found.is_below(before.value - before.sign * self.tolerance):
            return ""
        by = "" if found.value is None else f" by {abs(before.value - found.value):.4g}"
        unit = found.unit and f" {found.unit}"
        return (
            f"{found.name}: fell{by} from {before.text} to {found.text}, more than the"
            f" {self.tolerance:g}{unit} allowed"
        )


def build_gate(at_least: str | None, baseline: Path | None, tolerance: str | None) -> Gate:
    """The gate that options ask for.

    Raises:
        ScenarioError: a number cannot be read, or the baseline holds no results.
    """
    if tolerance is not None and baseline is None:
        raise ScenarioError(f"--tolerance {tolerance}: needs --baseline")
    limit, unit = _size("--at-least", at_least)
    allowed, other = _size("--tolerance", tolerance)
    if unit and other and unit != other:
        raise ScenarioError(f"--tolerance {tolerance}: must have the unit of --at-least, {unit}")
    if allowed is not None and not allowed >= 0.0:
        raise ScenarioError(f"--tolerance {tolerance}: must be 0 or more")
    found = [] if baseline is None else gauged(_read(baseline))
    if baseline is not None and not found:
        raise ScenarioError(
            f"--baseline {baseline}: must be summary.json of a run or study, or its folder"
        )
    return Gate(limit, {each.name: each for each in found}, allowed or 0.0, unit or other)


def require_unit(gate: Gate, unit: str) -> None:
    """Check that a gate's numbers are in the unit of a result.

    Raises:
        ScenarioError: they, or those of the baseline, are not.
    """
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


def gauged(summary: Mapping[str, Any]) -> list[Gauged]:
    """The numbers of a ``summary.json`` that a gate looks at."""
    kind = summary.get("kind", "run")
    if kind in ("margin", "robustness"):
        key = "margin" if kind == "margin" else "kept_up_to"
        return [
            Gauged(f"{case['arm']}, {case_name(case)}", case[key], summary["unit"] or "",
                   1 if case.get("growth", 1) > 0 else -1)
            for case in summary["cases"]
        ]  # fmt: skip
    if kind == "sweep":
        return [_point(summary, point) for point in summary["points"]]
    runs = summary["laws"].values() if kind == "comparison" else [summary]
    return [_run(run) for run in runs if "law" in run]


def _point(summary: Mapping[str, Any], point: Mapping[str, Any]) -> Gauged:
    values = zip(summary["axes"], point["values"], strict=True)
    name = ", ".join(f"{', '.join(axis['keys'])} = {shown_value(value)}" for axis, value in values)
    is_kept, smallest = point["runs_kept"] == point["runs"], point["margin_min"]["lowest"]
    return Gauged(name, 100.0 * smallest if is_kept else None, OF_BOUND)


def _run(summary: Mapping[str, Any]) -> Gauged:
    name = f"{summary['scenario']}, {summary['law']}"
    is_kept = summary["verdict"] == Verdict.KEPT
    return Gauged(name, 100.0 * summary["bounds"]["margin_min"] if is_kept else None, OF_BOUND)


def _size(option: str, text: str | None) -> tuple[float | None, str]:
    """A number and its unit from ``20ms``."""
    if text is None:
        return None, ""
    found = _SIZE.fullmatch(text)
    if found is None:
        raise ScenarioError(f"{option} {shown(text)}: must be a number, such as 20 or 20ms")
    return float(found[1]), found[2]


def _read(path: Path) -> dict[str, Any]:
    return read_json(path / "summary.json" if path.is_dir() else path)

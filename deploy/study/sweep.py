"""A sweep: every combination of the values of a grid, with every seed."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from bus_schema.configuration import StrictModel
from deploy.runs.run_rows import Row
from deploy.scenario.scenario import Setup, load_setup
from deploy.scenario.yaml_files import ScenarioError
from deploy.study.definition import (
    Name,
    Seeds,
    find_study,
    override,
    read_definition,
    scenario_from,
)
from deploy.study.statistics import spread_of_runs
from deploy.study.study import Run

KIND = "sweep"
_MOST_VALUES = 10_000


def _to_values(given: Any) -> Any:
    """Values of one key: as listed, or from ``{from, to, step}``, both ends included."""
    values = _steps(given) if isinstance(given, dict) else given
    if not isinstance(values, list) or not values:
        raise ValueError("a list of values, or numbers {from, to, step} with a step above 0")
    if len({json.dumps(value, default=str) for value in values}) < len(values):
        raise ValueError("a list of different values")
    return values


def _steps(given: dict[str, Any]) -> list[float] | None:
    if set(given) != {"from", "to", "step"}:
        return None
    first, last, step = given["from"], given["to"], given["step"]
    if any(type(number) not in (int, float) for number in (first, last, step)):
        return None
    if not step > 0 or not 0 <= (last - first) / step < _MOST_VALUES:
        return None
    count = math.floor((last - first) / step + 1e-9) + 1
    return [round(first + index * step, 12) for index in range(count)]


Values = Annotated[list[Any], BeforeValidator(_to_values)]


class SweepDefinition(StrictModel):
    """A sweep, as its YAML file has it.

    Attributes:
        name: of the sweep.
        scenario: a scenario file, relative to this one, or the name of a shipped one.
        fixed: (in YAML ``set``) scenario values that are the same in all runs, by dotted key.
        grid: lists of values by dotted key of the scenario; several keys, separated by commas, take
            each value together.
        seeds: how many, or which.
    """

    name: Name
    scenario: str
    fixed: Annotated[dict[str, Any], Field(alias="set", default_factory=dict)]
    grid: dict[str, Values]
    seeds: Seeds = Field(default=[1])


class Sweep:
    """The runs of a sweep.

    Attributes:
        axes: values by the keys that take them together.
        columns: columns of all these keys, with their types in Parquet.

    Args:
        definition: what to sweep.
        folder: folder of its file, from which the scenario's path starts.
        source: what to call it in messages.

    Raises:
        ScenarioError: a point of the grid is no scenario that can be run.
    """

    kind = KIND

    def __init__(self, definition: SweepDefinition, folder: Path, source: str) -> None:
        self.definition = definition
        self.axes = {tuple(_keys(text)): values for text, values in definition.grid.items()}
        _check_keys(self.axes, definition.fixed, source)
        self._fixed = tuple(override(key, value) for key, value in definition.fixed.items())
        self.columns = {k: _kind(values) for keys, values in self.axes.items() for k in keys}
        try:
            self.scenario = scenario_from(definition.scenario, folder)
            self.base = load_setup(self.scenario, self._fixed)
            for run in self.points():
                load_setup(run.scenario, run.overrides)
        except ScenarioError as error:
            raise ScenarioError(f"{source}: {error}") from error

    @property
    def name(self) -> str:
        return self.definition.name

    @property
    def seeds(self) -> list[int]:
        return self.definition.seeds

    @property
    def bases(self) -> list[Setup]:
        """The scenarios that it varies."""
        return [self.base]

    @property
    def expected(self) -> int:
        """Number of runs."""
        return math.prod(map(len, self.axes.values())) * len(self.seeds)

    def definition_values(self) -> dict[str, Any]:
        """The definition as plain values, from which `restore` makes it again."""
        return self.definition.model_dump(by_alias=True) | {"scenario": self.scenario}

    def points(self) -> Iterable[Run]:
        """One run for each point of the grid, with the first seed."""
        for index, values in enumerate(itertools.product(*self.axes.values())):
            chosen = {
                key: value
                for keys, value in zip(self.axes, values, strict=True)
                for key in keys
            }  # fmt: skip
            overrides = (*self._fixed, *(override(key, value) for key, value in chosen.items()))
            columns = {key: _as_cell(value, self.columns[key]) for key, value in chosen.items()}
            seed = self.seeds[0]
            yield Run(f"{index:05d}", self.scenario, overrides, seed, columns)

    def first(self) -> Iterable[Run]:
        """All runs."""
        for run in self.points():
            for seed in self.seeds:
                yield Run(run.point, run.scenario, run.overrides, seed, run.columns)

    def follow(self, _run: Run, _values: Row) -> Iterable[Run]:
        """No run depends on another."""
        return ()

    def summary(self, rows: list[Row]) -> dict[str, Any]:
        """What came of it, point by point."""
        by_point: dict[str, list[Row]] = {}
        for row in rows:
            by_point.setdefault(row["point"], []).append(row)
        return {
            "kind": KIND,
            "name": self.name,
            "scenario": self.base.scenario.name,
            "completed": len(rows) == self.expected,
            "runs": len(rows),
            "runs_expected": self.expected,
            "runs_failed": sum(row["error"] is not None for row in rows),
            "seeds": self.seeds,
            "joint_names": list(self.base.robot.joint_names),
            "axes": [
                {"keys": list(keys), "values": [_as_cell(v, self.columns[keys[0]]) for v in values]}
                for keys, values in self.axes.items()
            ],
            "points": [
                {
                    "point": run.point,
                    "values": [run.columns[keys[0]] for keys in self.axes],
                    **spread_of_runs(by_point[run.point]),
                }
                for run in self.points()
                if run.point in by_point
            ],
        }


def load_sweep(name_or_path: str) -> Sweep:
    """A sweep from a file, or a shipped one.

    Raises:
        ScenarioError: anything about it is wrong.
    """
    path = find_study(name_or_path)
    return Sweep(read_definition(path, SweepDefinition), path.parent, str(path))


def restore(values: dict[str, Any], folder: Path) -> Sweep:
    """A sweep from the definition that its folder keeps."""
    return Sweep(SweepDefinition.model_validate(values), folder, str(folder))


def _keys(text: str) -> list[str]:
    return [key.strip() for key in text.split(",")]


def _check_keys(axes: dict[tuple[str, ...], Any], fixed: dict[str, Any], source: str) -> None:
    keys = [key for tied in axes for key in tied] + list(fixed)
    for key in keys:
        if not key:
            raise ScenarioError(f"{source}: grid: must name dotted keys, separated by commas")
        if keys.count(key) > 1:
            raise ScenarioError(f"{source}: {key}: must be given once, in grid or in set")
    if "seed" in keys:
        raise ScenarioError(f"{source}: seed: must be given under seeds, not in grid or set")


def _kind(values: list[Any]) -> str:
    """The Parquet type that holds all values."""
    kinds = {type(value) for value in values}
    if kinds == {bool}:
        return "bool"
    return "double" if kinds <= {int, float} else "string"


def _as_cell(value: Any, kind: str) -> Any:
    if kind == "double":
        return float(value)
    return value if kind == "bool" or isinstance(value, str) else json.dumps(value, default=str)

"""A sweep: every combination of the values of a grid, with every seed."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

from pydantic import BeforeValidator

from bus_schema.configuration import ConfigurationError, shown
from deploy.judge.run_rows import Row, held
from deploy.scenario import study_keys
from deploy.scenario.referenced_files import data_files
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.uncertainty import split_keys
from deploy.scenario.yaml_files import ScenarioError, naming, override, validated
from deploy.study.definition import is_sweep, require_different, scenario_name, study_values
from deploy.study.execution.growth import has_all, lacks
from deploy.study.losses import share_kept
from deploy.study.planned_run import PlannedRun
from deploy.study.plants import UncertainDefinition, Variant, draw_columns, draw_plants, with_ranges
from deploy.study.statistics import badness, spread_of_runs, without_effect
from deploy.study.study import StudyOfRuns, column_type, digest_of, rows_by

_TYPES = {
    "bool": "true or false",
    "double": "numbers",
    "string": "neither numbers nor true or false",
}
"""Kind of a grid's values, by the Parquet type of their column."""
_MOST_VALUES = 10_000
_MOST_RUNS = 100_000


def _to_values(given: Any) -> Any:
    """Return the values of one key: as listed, or from ``{from, to, step}``, both ends included."""
    values = _steps(given) if isinstance(given, dict) else given
    if not isinstance(values, list) or not values:
        raise ValueError("a list of values, or numbers {from, to, step} with a step above 0")
    return require_different(values)


def _steps(given: dict[str, Any]) -> list[float] | None:
    if set(given) != {"from", "to", "step"}:
        return None
    first, last, step = given["from"], given["to"], given["step"]
    if any(type(number) not in (int, float) for number in (first, last, step)):
        return None
    if not step > 0 or not first <= last:
        return None
    steps = (last - first) / step + 1e-9
    if not steps < _MOST_VALUES:
        raise ValueError(f"at most {_MOST_VALUES} values; these are {steps + 1:.10g}")
    count = math.floor(steps) + 1
    return [round(first + index * step, 12) for index in range(count)]


Values = Annotated[list[Any], BeforeValidator(_to_values)]


class SweepDefinition(UncertainDefinition):
    """Definition of a sweep, as in its YAML file.

    Attributes:
        scenario: a scenario file, relative to this one, or the name of a shipped one.
        grid: lists of values by dotted key of the scenario; several keys, separated by commas, take
            each value together.
    """

    scenario: str
    grid: dict[str, Values]


def _grid_growth(key: str, old: Any, new: Any) -> Iterator[str]:
    """Axes grow by further values of the same type; axes are neither added nor removed."""
    if not (isinstance(old, dict) and isinstance(new, dict)):
        yield lacks(key, old, new)
        return
    for axis in dict.fromkeys((*old, *new)):
        before, now = old.get(axis), new.get(axis)
        if before is None or now is None or not has_all(now, before):
            yield lacks(f"{key}.{axis}", before, now)
        elif (kind := column_type(before)) != column_type(now):
            yield f"{key}.{axis} = {shown(now)}: must all be {_TYPES[kind]}, as before"


class Sweep(StudyOfRuns):
    """The runs of a sweep.

    Attributes:
        axes: values by the keys that share them.
        plants: the plants, each tried at every point of the grid.
    """

    kind = "sweep"
    growth = MappingProxyType({**StudyOfRuns.growth, "grid": _grid_growth})
    definition: SweepDefinition

    def __init__(self, values: Mapping[str, Any], source: Path) -> None:
        with naming(source):
            ranged = with_ranges(values, source)
        given = validated(ranged, SweepDefinition, source)
        self.axes = {split_keys(keys): values for keys, values in given.grid.items()}
        axes = {key: column_type(values) for keys, values in self.axes.items() for key in keys}
        with naming(source):
            _check_keys(self.axes, given)
            _check_runs(self.axes, given)
            scenario = scenario_name(given.scenario, source.parent)
            self.definition = given.model_copy(update={"scenario": scenario})
            self.bases = [load_setup(scenario, given.fixed_overrides, "set")]
            self.plants = draw_plants(given, self.bases[0], [*axes, study_keys.SEED])
            self.columns = {**axes, **draw_columns(given, self.bases)}
            self._check()

    @property
    def laws(self) -> list[str]:
        return next(
            (values for keys, values in self.axes.items() if study_keys.LAW in keys), super().laws
        )

    def points(self) -> Iterable[PlannedRun]:
        """Return one run for each point of the grid and each plant, with the first seed."""
        wanted = self.definition
        for index, values in enumerate(itertools.product(*self.axes.values())):
            chosen = {
                key: value
                for keys, value in zip(self.axes, values, strict=True)
                for key in keys
            }  # fmt: skip
            varied = [override(key, value) for key, value in chosen.items()]
            columns = {key: _as_cell(value, self.columns[key]) for key, value in chosen.items()}
            for plant in self.plants:
                yield PlannedRun(
                    _point(index, plant), wanted.scenario,
                    (*wanted.fixed_overrides, *plant.overrides, *varied), wanted.seeds[0],
                    {**columns, **plant.columns}, bool(wanted.confirm),
                )  # fmt: skip

    def first(self) -> Iterable[PlannedRun]:
        return (replace(run, seed=seed) for run in self.points() for seed in self.definition.seeds)

    @property
    def own_test(self) -> dict[str, Any]:
        keys = {"plants", "plant_seed", "uncertainty"}
        return {**super().own_test, **self.definition.model_dump(include=keys, mode="json")}

    def findings(self, rows: list[Row]) -> dict[str, Any]:
        by_point = rows_by(rows, lambda row: _grid_point(row["point"]))
        base = self.bases[0]
        runs = itertools.islice(self.points(), 0, None, len(self.plants))
        completed, varied = len(rows) == self.expected, [*self.axes, (study_keys.SEED,)]
        return {
            "scenario": base.scenario.name,
            "completed": completed,
            "runs_expected": self.expected,
            "joint_names": list(base.robot.joint_names),
            "plants": self.definition.plants,
            "plant_seed": self.definition.plant_seed,
            "without_effect": without_effect(rows, varied, self.columns) if completed else [],
            "axes": [
                {"keys": list(keys), "values": [_as_cell(v, self.columns[keys[0]]) for v in values]}
                for keys, values in self.axes.items()
            ],
            "points": [
                self._point_summary(run, by_point[_grid_point(run.point)])
                for run in runs
                if _grid_point(run.point) in by_point
            ],
        }

    def _check(self) -> None:
        """Load every point of the grid with the first plant, and every plant at the first point."""
        by_kind, files = dict[str, Setup](), dict[str, str]()
        for index, run in enumerate(self.points()):
            plant = self.plants[index % len(self.plants)]
            if index < len(self.plants) or plant is self.plants[0]:
                try:
                    setup = load_setup(run.scenario, run.overrides, "grid")
                except ScenarioError as error:
                    raise plant.refused(error) from error
                by_kind.setdefault(setup.scenario.link.kind, setup)
                files |= _file_digests(setup)
        of_base = _file_digests(self.bases[0])
        self.files = {name: digest for name, digest in files.items() if name not in of_base}
        study_keys.require_link_effect(self.definition.fixed, by_kind.values())
        for keys, values in self.axes.items():
            for key, value in itertools.product(keys, values):
                study_keys.require_link_effect({key: value}, by_kind.values())

    def _point_summary(self, run: PlannedRun, rows: list[Row]) -> dict[str, Any]:
        """Summarise a point of the grid; for uncertain plants with the number that were kept."""
        summary = {
            "point": _grid_point(run.point),
            "worst_point": max(rows, key=badness)["point"],
            "values": [run.columns[keys[0]] for keys in self.axes],
            **spread_of_runs(rows),
        }
        if self.definition.plants is None:
            return summary
        by_plant = rows_by(rows, lambda row: row["point"]).values()
        whole = [runs for runs in by_plant if len(runs) == len(self.definition.seeds)]
        kept = sum(all(map(held, runs)) for runs in whole)
        return {**summary, **share_kept(kept, len(whole))}


def load_sweep(
    name_or_path: str,
    more: Mapping[str, Any] = MappingProxyType({}),
    fixed: Mapping[str, Any] = MappingProxyType({}),
) -> Sweep:
    """Return a sweep from a file, or a shipped one.

    Args:
        name_or_path: its name or path.
        more: values that take precedence over the file.
        fixed: scenario values that take precedence over those of its ``set``.

    Raises:
        ScenarioError: anything about it is wrong.
    """
    return Sweep(*study_values(name_or_path, more, fixed, is_sweep))


def _point(index: int, plant: Variant) -> str:
    return f"{index:05d}-{plant.number:04d}" if plant.number else f"{index:05d}"


def _grid_point(point: str) -> str:
    """Return the part of a point's name that all of its plants share."""
    return point.partition("-")[0]


def _check_keys(axes: Mapping[tuple[str, ...], list[Any]], given: SweepDefinition) -> None:
    """Check that every value of grid and set has an effect."""
    values = {key: tried for tied, tried in axes.items() for key in tied}
    keys = [key for tied in axes for key in tied]
    if not all(keys):
        raise ScenarioError("grid: must name dotted keys, separated by commas")
    once = "once, in grid or in set (--set)"
    for key in keys:
        if keys.count(key) > 1:
            raise ScenarioError(f"{key}: must be given {once}")
    own = {study_keys.SEED: "under seeds, not in grid or set"}
    if given.plants is None:
        own[study_keys.UNCERTAINTY] = "beside plants (--plants)"
        for key in ("plant_seed", study_keys.UNCERTAINTY):
            value = getattr(given, key)
            if value != type(given).model_fields[key].default:  # added to study.yaml
                raise ConfigurationError(key, value, "must be left out without plants")
    elif given.uncertainty is not None:
        own[study_keys.UNCERTAINTY] = "as uncertainty of the sweep (--uncertainty)"
    study_keys.require_effect(given.fixed, own | dict.fromkeys(keys, once))
    for key, tried in values.items():
        others = dict.fromkeys((other for other in keys if other != key), once)
        for value in tried:
            study_keys.require_effect({key: value}, own | others)


def _check_runs(axes: Mapping[tuple[str, ...], Any], given: SweepDefinition) -> None:
    """Limit the runs: each point is checked before the first one, and every row is kept."""
    points, plants = math.prod(map(len, axes.values())), given.plants or 1
    runs = points * plants * len(given.seeds)
    if runs > _MOST_RUNS:
        many = f"{points} points × {plants} plants × {len(given.seeds)} seeds are {runs} runs"
        raise ScenarioError(f"grid: {many}; at most {_MOST_RUNS} are allowed")


def _file_digests(setup: Setup) -> dict[str, str]:
    """Return digests of a scenario's files by path; for an arm, of its file's URDF."""
    digests = {
        str(file): digest_of(file.read_bytes()) for file in data_files(setup.scenario).values()
    }
    return {**digests, str(setup.robot.path): digest_of(setup.robot.text.encode())}


def _as_cell(value: Any, kind: str) -> Any:
    if kind == "double":
        return float(value)
    return value if kind == "bool" or isinstance(value, str) else json.dumps(value, default=str)

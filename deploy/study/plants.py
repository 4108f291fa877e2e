"""Plants of a study: always the same arm, or several that are drawn."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from bus_schema.arrays import elementwise
from bus_schema.configuration import ConfigurationError, Whole
from deploy.scenario.setup import Setup
from deploy.scenario.uncertainty import (
    Draw,
    Uncertainty,
    check_uncertainty,
    draw_plant,
    key_text,
    number_at,
    split_keys,
)
from deploy.scenario.yaml_files import ScenarioError, find_yaml, override, plain, read_yaml
from deploy.study.definition import SHIPPED, StudyDefinition

RANGES = SHIPPED / "ranges"
_MOST_PLANTS = 1000


class UncertainDefinition(StudyDefinition):
    """Settings of uncertain plants in a study's YAML file.

    Attributes:
        plants: number of drawn plants; null for the scenario's own arm.
        plant_seed: seed of the plants. A larger number of plants begins with the same ones.
        uncertainty: the ranges to draw from; a file of ranges, the name of a shipped one, or the
            ranges themselves; the scenario's own if null.
    """

    plants: Annotated[Whole, Field(ge=1, le=_MOST_PLANTS)] | None = None
    plant_seed: Annotated[Whole, Field(ge=0)] = 1
    uncertainty: Uncertainty | None = None


@dataclass(frozen=True)
class Variant:
    """An arm of a study: the scenario's own, from another start, or drawn.

    Attributes:
        number: its number; drawn ones count from 1.
        overrides: the overrides that define it.
        last: overrides of values that a growing quantity sets.
        columns: values that identify it, by column of the table.
    """

    number: int = 0
    overrides: tuple[str, ...] = ()
    columns: Mapping[str, Any] = field(default_factory=dict)
    last: tuple[str, ...] = ()

    def refused(self, error: ScenarioError) -> ScenarioError:
        """Explain that the scenario refuses it."""
        if "plant" not in self.columns:
            return error
        drawn = {key: value for key, value in self.columns.items() if key != "plant"}
        after = (
            "; narrow the ranges under uncertainty so that this cannot be drawn."
            f" Drawn: {json.dumps(drawn)}"
        )
        return ScenarioError(*error.lines(f"plant {self.number}: ", after))


@dataclass(frozen=True)
class Measured:
    """One number of each plant, to compare with which of them were lost.

    Attributes:
        name: its name.
        values: shape (plants,).
    """

    name: str
    values: np.ndarray[tuple[int], np.dtype[np.float64]]


def with_ranges(values: Mapping[str, Any], source: Path) -> dict[str, Any]:
    """Return a definition with the ranges themselves instead of the name of their file.

    Raises:
        ScenarioError: there is no such file.
    """
    named = values.get("uncertainty")
    if not isinstance(named, str):
        return dict(values)
    return {**values, "uncertainty": read_yaml(find_yaml(named, RANGES, source.parent))}


def uncertainty_of(wanted: UncertainDefinition, base: Setup) -> Uncertainty:
    """Return the ranges to draw from for a scenario.

    Raises:
        ScenarioError: there are none.
    """
    if wanted.uncertainty is not None:
        return wanted.uncertainty
    if not base.scenario.uncertainty:
        raise ScenarioError(
            "uncertainty: is needed for plants, in the study (--uncertainty) or in the scenario"
            f" {base.scenario.name}"
        )
    return base.scenario.uncertainty


def draw_plants(wanted: UncertainDefinition, base: Setup, taken: Iterable[str]) -> list[Variant]:
    """Draw the plants for a scenario.

    Args:
        wanted: number of plants, and ranges.
        base: the scenario.
        taken: keys that the study itself sets.

    Raises:
        ScenarioError: they cannot be drawn.
        ConfigurationError: likewise.
    """
    if wanted.plants is None:
        return [Variant()]
    uncertainty = uncertainty_of(wanted, base)
    _require_free(uncertainty, wanted.fixed, taken)
    scenario, joints = plain(base.scenario), base.robot.joints
    check_uncertainty(uncertainty, scenario, joints)
    # A drawn plant is certain: a new run of it must not draw again.
    settled = (override("uncertainty", {}),) if base.scenario.uncertainty else ()
    plants = []
    for number in range(1, wanted.plants + 1):
        drawn = draw_plant(uncertainty, scenario, joints, seed=wanted.plant_seed, number=number)
        columns = {"plant": number, **drawn.draws}
        plants.append(Variant(number, (*drawn.overrides, *settled), columns))
    if len(plants) > 1 and len({plant.overrides for plant in plants}) == 1:
        allowed = "must draw different plants: a factor on 0, or a choice of one value, draws none"
        raise ConfigurationError("uncertainty", ", ".join(uncertainty) or {}, allowed)
    return plants


def draw_columns(wanted: UncertainDefinition, bases: Iterable[Setup]) -> dict[str, str]:
    """Return names and Parquet types of drawn values, for all scenarios of a study."""
    if wanted.plants is None:
        return {}
    kinds = {"arm": "double", "joint": "list<double>"}
    draws = {
        key_text(text): kinds[draw.per]
        for base in bases
        for text, draw in uncertainty_of(wanted, base).items()
    }
    return {"plant": "int64", **draws}


def measured(uncertainty: Uncertainty, plants: list[Variant], base: Setup) -> list[Measured]:
    """Return every drawn number of each plant, joint by joint.

    A number with a random sign counts as two: its size, and its sign. For a number of the whole arm
    whose range lies on both sides of the scenario's own value, the distance from the middle also
    counts, as too little may be as harmful as too much.
    """
    found, scenario = [], plain(base.scenario)
    for text, draw in uncertainty.items():
        name = key_text(text)
        rows = np.array([np.atleast_1d(plant.columns[name]) for plant in plants], dtype=np.float64)
        own = 1.0 if draw.relative else number_at(scenario, split_keys(text)[0])
        for joint, values in enumerate(rows.T):
            where = f", {base.robot.joint_names[joint]}" if draw.per == "joint" else ""
            found += _aspects(f"{name}{where}", draw, values, own)
    return found


def _aspects(name: str, draw: Draw, values: Any, own: Any) -> list[Measured]:
    if draw.random_sign:
        size = Measured(f"{name}, size", np.abs(values))
        return [size, Measured(f"{name}, sign", np.sign(values))]
    least, most = draw.least, draw.most
    if draw.per == "joint" or least is None or most is None:
        return [Measured(name, values)]
    if not least < np.min(own) <= np.max(own) < most:
        return [Measured(name, values)]
    if draw.distribution == "log_uniform":
        middle = math.sqrt(least * most)
        distance = elementwise(lambda value: abs(math.log(value / middle)), values)
    else:
        distance = np.abs(values - 0.5 * (least + most))
    return [Measured(name, values), Measured(f"{name}, distance from mid-range", distance)]


def _require_free(uncertainty: Uncertainty, fixed: Mapping[str, Any], taken: Iterable[str]) -> None:
    """Refuse draws of keys that the study sets by itself; factors on fixed keys are allowed."""
    set_by_study = set(taken)
    for text, draw in uncertainty.items():
        for key in split_keys(text):
            if key in set_by_study or (key in fixed and draw.relative is not True):
                raise ScenarioError(
                    f"{key}: must be given once, by the study (set, grid, quantity) or by a draw"
                    " under uncertainty; a factor (relative: true) may stand beside set"
                )

"""What sweeps and margins have in common as definitions: name, overrides, seeds, scenarios."""

from __future__ import annotations

import json
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BeforeValidator, Field

from bus_schema.configuration import StrictModel
from deploy.scenario.scenario import SHIPPED as SHIPPED_SCENARIOS
from deploy.scenario.yaml_files import find_yaml, override

SHIPPED = Path(str(resources.files("deploy").joinpath("studies")))

_MOST_SEEDS = 10_000

Value = TypeVar("Value")


def require_different(values: list[Any]) -> list[Any]:
    """For lists of values to try: one or more, of whatever type YAML has, and none twice."""
    if not values or len({json.dumps(value, default=str) for value in values}) < len(values):
        raise ValueError("a list of different values")
    return values


Different = Annotated[list[Value], AfterValidator(require_different)]
"""Different values of a type."""


def _to_seeds(value: Any) -> Any:
    seeds = list(range(1, value + 1)) if type(value) is int and value <= _MOST_SEEDS else value
    whole = isinstance(seeds, list) and all(type(seed) is int and seed >= 0 for seed in seeds)
    if not whole or not seeds or len(set(seeds)) < len(seeds):
        raise ValueError(
            f"a number of seeds from 1 to {_MOST_SEEDS}, or a list of different whole numbers"
        )
    return seeds


Seeds = Annotated[list[int], BeforeValidator(_to_seeds)]
"""Given as a list, or as a number n for 1 to n."""

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]


class StudyDefinition(StrictModel):
    """What every study's YAML file may have.

    Attributes:
        name: of the study.
        fixed: (in YAML ``set``) scenario values that are the same in all runs, by dotted key.
        seeds: how many, or which.
    """

    name: Name
    fixed: Annotated[dict[str, Any], Field(alias="set", default_factory=dict)]
    seeds: Seeds = Field(default=[1])

    @property
    def fixed_overrides(self) -> tuple[str, ...]:
        return tuple(override(key, value) for key, value in self.fixed.items())


def scenario_name(name_or_path: str, folder: Path) -> str:
    """A scenario as a study names it: shipped ones by name, files by their absolute path.

    Args:
        name_or_path: a path relative to `folder`, or what commands take for a scenario.
        folder: folder of the study's definition.

    Raises:
        ScenarioError: there is no such scenario.
    """
    found = find_yaml(name_or_path, SHIPPED_SCENARIOS, folder)
    return found.stem if found.parent == SHIPPED_SCENARIOS else str(found)

"""Definitions of studies: what their YAML files have in common, and how they are read."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BeforeValidator, Field

from bus_schema.configuration import StrictModel
from deploy.scenario.definition import Name
from deploy.scenario.scenario import SHIPPED as SHIPPED_SCENARIOS
from deploy.scenario.xacro_arguments import split_arguments
from deploy.scenario.yaml_files import ScenarioError, find_yaml, override, read_yaml

SHIPPED = Path(str(resources.files("deploy").joinpath("studies")))
_MOST_SEEDS = 10_000


def require_different(values: list[Any]) -> list[Any]:
    """Require a list of one or more different values, of any YAML type."""
    if not values or len({json.dumps(value, default=str) for value in values}) < len(values):
        raise ValueError("a list of different values")
    return values


Value = TypeVar("Value")

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


class StudyDefinition(StrictModel):
    """Common keys of all studies' YAML files.

    Attributes:
        name: name of the study.
        fixed: (in YAML ``set``) scenario values that are the same in all runs, by dotted key.
        seeds: number of seeds, or a list.
        confirm: simulate every run on other physics too, see `deploy.run.confirmation`.
    """

    name: Name
    fixed: Annotated[dict[str, Any], Field(alias="set", default_factory=dict)]
    seeds: Seeds = Field(default=[1])
    confirm: bool | None = None

    @property
    def fixed_overrides(self) -> tuple[str, ...]:
        return tuple(override(key, value) for key, value in self.fixed.items())


def scenario_name(name_or_path: str, folder: Path) -> str:
    """Return a scenario's name in a study: shipped ones by name, files by their absolute path.

    Args:
        name_or_path: a path relative to `folder`, or any name that commands accept.
        folder: folder of the study's definition.

    Raises:
        ScenarioError: there is no such scenario.
    """
    file, arguments = split_arguments(name_or_path)
    found = find_yaml(file, SHIPPED_SCENARIOS, folder)
    words = [f"{name}:={value}" for name, value in arguments.items()]
    return found.stem if found.parent == SHIPPED_SCENARIOS else " ".join([str(found), *words])


def require_own_names(scenarios: Iterable[tuple[str, str]]) -> None:
    """Require different names of scenarios, which identify them in rows.

    Args:
        scenarios: name and file of each.

    Raises:
        ScenarioError: two files have the same name.
    """
    files: dict[str, str] = {}
    for name, file in scenarios:
        if files.setdefault(name, file) != file:
            raise ScenarioError(
                f"scenarios: {files[name]} and {file} are both called {name!r}:"
                " must have different names"
            )


def study_values(
    name_or_path: str,
    more: Mapping[str, Any] = MappingProxyType({}),
    fixed: Mapping[str, Any] = MappingProxyType({}),
    fits: Callable[[Path], bool] = lambda _file: True,
) -> tuple[dict[str, Any], Path]:
    """Return the definition in a study's file, and the file.

    Args:
        name_or_path: its path, or the name of a shipped one.
        more: values that take precedence over the file.
        fixed: scenario values that take precedence over those of its ``set``.
        fits: whether a shipped file is of the wanted kind.

    Raises:
        ScenarioError: it cannot be read.
    """
    path = find_yaml(name_or_path, SHIPPED, fits=fits)
    values = {**definition_in(path), **more}
    own = values.get("set") or {}
    if fixed and isinstance(own, dict):  # or the schema refuses it
        values["set"] = {**own, **fixed}
    return values, path


def definition_in(file: Path) -> dict[str, Any]:
    """Return the definition in a study's file, or in the ``study.yaml`` of its results."""
    values = read_yaml(file)
    inner = values.get("definition")
    return inner if isinstance(inner, dict) and "kind" in values else values


def is_sweep(file: Path) -> bool:
    """Whether a study's file is for `sweep`; the others are for `margin`."""
    return "grid" in definition_in(file)

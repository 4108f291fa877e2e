"""What sweeps and margins have in common as definitions: files, overrides, seeds."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BeforeValidator, Field, ValidationError

from bus_schema.configuration import StrictModel
from deploy.scenario.scenario import SHIPPED as SHIPPED_SCENARIOS
from deploy.scenario.scenario import find_scenario
from deploy.scenario.yaml_files import ScenarioError, explain, read_yaml

SHIPPED = Path(str(resources.files("deploy").joinpath("studies")))

_MOST_SEEDS = 10_000

Definition = TypeVar("Definition", bound=StrictModel)


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


def find_study(name_or_path: str) -> Path:
    """The file of a study.

    Raises:
        ScenarioError: there is none.
    """
    path, shipped = Path(name_or_path), SHIPPED / f"{name_or_path}.yaml"
    if path.is_file():
        return path.resolve()
    if shipped.is_file():
        return shipped
    names = ", ".join(sorted(file.stem for file in SHIPPED.glob("*.yaml")))
    raise ScenarioError(f"{name_or_path}: no such file, nor one of the shipped studies {names}")


def read_definition(path: Path, model: type[Definition], **more: Any) -> Definition:
    """A definition from a file.

    Args:
        path: the YAML file.
        model: what it has to be.
        more: values that take precedence over the file's.

    Raises:
        ScenarioError: a value cannot be used.
    """
    return validated({**read_yaml(path), **more}, model, path)


def validated(values: Mapping[str, Any], model: type[Definition], source: Path) -> Definition:
    """A definition from its values.

    Raises:
        ScenarioError: one of them cannot be used; `source` is named.
    """
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise ScenarioError(explain(error, source)) from error


def scenario_from(name_or_path: str, folder: Path) -> str:
    """A scenario as a study names it: shipped ones by name, files by their absolute path.

    Args:
        name_or_path: a path relative to `folder`, or what commands take for a scenario.
        folder: folder of the study's definition.

    Raises:
        ScenarioError: there is no such scenario.
    """
    beside = folder / name_or_path
    found = beside.resolve() if beside.is_file() else find_scenario(name_or_path)
    return found.stem if found.parent == SHIPPED_SCENARIOS else str(found)


def override(key: str, value: Any) -> str:
    """``dotted.key=value`` for a value of any type that YAML has."""
    return f"{key}={json.dumps(value, default=str)}"

"""YAML files with values that a schema checks, messages about wrong ones, and values as YAML."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from difflib import get_close_matches
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import yaml
from pydantic import BaseModel, ValidationError

from bus_schema.configuration import ConfigurationError, SettingsError, shown
from bus_schema.errors import InputError, did_you_mean
from bus_schema.foreign_text import shortened
from bus_schema.user_files import ARM_FILES, is_file, named_in_folder, read_text
from deploy.scenario.checking.explanation import Origin, explain
from deploy.scenario.yaml_text import problem_in, values_of

# Several times as fast, where it is available.
_DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)

_YAML, _MOST_COMPARED = ".yaml", 2000
_XML = ("<?xml", "<!--", "<robot")
FAULTS = "faults"
"""Folder of the shipped scenarios with faults."""

Model = TypeVar("Model", bound=BaseModel)


class ScenarioError(InputError):
    """A scenario cannot be used; the message names file, key, value and what is allowed."""


@contextmanager
def naming(source: Path | Origin) -> Iterator[None]:
    """Add the file's name, or the option that set the values, to errors about values.

    Raises:
        ScenarioError: for a `ConfigurationError`, or another error that names no file yet.
    """
    origin = source if isinstance(source, Origin) else Origin(source)
    try:
        yield
    except SettingsError as error:
        explained = explain(error.error, error.model, origin, error.section.split("."))
        raise ScenarioError(*explained) from error
    except ConfigurationError as error:
        raise ScenarioError(f"{origin.of(error.key, error.beside)}: {error}") from error
    except ScenarioError as error:
        raise ScenarioError(*error.lines(f"{origin.file}: ")) from error


def find_yaml(
    name_or_path: str,
    shipped: Path,
    beside: Path = Path(),
    fits: Callable[[Path], bool] | None = None,
) -> Path:
    """Return a YAML file by its path, or a shipped one by its name.

    Args:
        name_or_path: the user's input.
        shipped: the folder of shipped files; messages use its name for the files.
        beside: another folder from which a path may start.
        fits: selects the shipped files that a message suggests; all by default.

    Raises:
        ScenarioError: there is none.
    """
    for path in (beside / name_or_path, Path(name_or_path)):
        if is_file(path):
            return path.resolve()
    by_name = shipped / f"{name_or_path}.yaml"
    if is_file(by_name):
        return by_name
    for path in (beside / name_or_path, Path(name_or_path)):
        if held := named_in_folder(path, (_YAML, *ARM_FILES)):
            raise ScenarioError(f"{shortened(name_or_path)}: {held}")
    names = sorted(file.stem for file in filter(fits, shipped.glob("*.yaml")))
    faults = sorted(f"{FAULTS}/{file.stem}" for file in shipped.glob(f"{FAULTS}/*.yaml"))
    listed = [*names, f"{FAULTS}/*"] if faults else names
    if faults and name_or_path.startswith(f"{FAULTS}/"):
        listed = faults
    is_there = any(os.path.exists(path) for path in (name_or_path, beside / name_or_path))  # noqa: PTH110 (raises nothing)
    what = "is not a regular file" if is_there else "no such file"
    hints = [did_you_mean(name_or_path, [*names, *faults]), _file_beside(name_or_path)]
    hint = next(filter(None, hints[::-1] if Path(name_or_path).suffix else hints), "")
    raise ScenarioError(
        f"{shortened(name_or_path)}: {what}, nor one of the shipped {shipped.name}"
        f" {', '.join(listed)}{hint}"
    )


def _file_beside(name: str) -> str:
    """Return ``; did you mean …?`` for a similar file of the same kind in the folder of a path."""
    given = Path(name)
    same = [kinds for kinds in ((_YAML,), ARM_FILES) if given.suffix in kinds]
    kinds = same[0] if same else (_YAML, *ARM_FILES)
    try:
        held = sorted(islice(given.parent.iterdir(), _MOST_COMPARED))
    except (OSError, ValueError):
        return ""
    held.sort(key=lambda each: each.suffix == given.suffix)
    by_name = {each.stem: each for each in held if each.suffix in kinds}
    found = get_close_matches(shortened(given.stem), by_name, n=1)
    return f"; did you mean {shortened(str(by_name[found[0]]))}?" if found else ""


def read_yaml(path: Path) -> dict[str, Any]:
    """Read a YAML file that contains a mapping.

    Raises:
        ScenarioError: it cannot be read, or is no mapping.
    """
    name = str(path)
    try:
        text = read_text(path)
        if text.lstrip().startswith(_XML):
            raise ScenarioError(
                f"{name}: must be a mapping of keys to values in YAML, but is XML. A URDF or xacro"
                f" file belongs under robot.urdf of a scenario; funnel-hil robot {name} shows it"
            )
        with naming(path):
            values = values_of(text)
    except yaml.YAMLError as error:
        raise ScenarioError(f"{name}: cannot be read as YAML: {problem_in(error)}") from error
    except OSError as error:
        raise ScenarioError(f"{name}: cannot be read as YAML: {error}") from error
    if not isinstance(values, dict):
        raise ScenarioError(f"{name}: must be a mapping of keys to values")
    return values


def parse_override(override: str) -> tuple[str, Any]:
    """Return dotted key and YAML value of ``dotted.key=value``.

    Raises:
        ScenarioError: it does not have that form.
    """
    key, separator, text = override.partition("=")
    if not separator or not key:
        raise ScenarioError(f"--set {shortened(override)}: must have the form dotted.key=value")
    return key, option_value(f"--set {shortened(override)}", text)


def option_value(option: str, text: str) -> Any:
    """Return the YAML value of an option.

    Raises:
        ScenarioError: it is no YAML; the message names `option`.
    """
    try:
        return values_of(text)
    except ConfigurationError as error:
        raise ScenarioError(f"{option}: {shown(error.value)} {error.allowed}") from error
    except (yaml.YAMLError, UnicodeEncodeError) as error:  # input may be no UTF-8
        raise ScenarioError(f"{option}: {shown(text)} is not valid YAML") from error


def override(key: str, value: Any) -> str:
    """Return ``dotted.key=value`` for a value of any YAML type."""
    return f"{key}={json.dumps(value, default=str)}"


def set_value(values: dict[str, Any], key: str, value: Any) -> None:
    """Set one of nested values by its dotted key."""
    *sections, last = key.split(".")
    for section in sections:
        inner = values.setdefault(section, {})
        if not isinstance(inner, dict):
            inner = values[section] = {}
        values = inner
    values[last] = value


def leaves(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Return all nested values with their dotted keys."""
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from leaves(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def validated(values: Mapping[str, Any], model: type[Model], source: Path | Origin) -> Model:
    """Return the model of values.

    Raises:
        ScenarioError: some of them cannot be used; the message names `source`.
    """
    try:
        return model.model_validate(values)
    except ValidationError as error:
        origin = source if isinstance(source, Origin) else Origin(source)
        raise ScenarioError(*explain(error, model, origin)) from error


def to_yaml(values: Mapping[str, Any]) -> str:
    """Return plain values as YAML, in their order."""
    return str(yaml.dump(values, Dumper=_DUMPER, sort_keys=False, allow_unicode=True))


def plain(value: Any) -> Any:
    """Return models, named tuples and arrays as mappings, lists and numbers, without None."""
    match value:
        case BaseModel():
            fields = type(value).model_fields.items()
            named = {field.alias or name: getattr(value, name) for name, field in fields}
            return {name: plain(inner) for name, inner in named.items() if inner is not None}
        case dict():
            return {name: plain(inner) for name, inner in value.items()}
        case tuple() if hasattr(value, "_asdict"):
            return {name: plain(inner) for name, inner in value._asdict().items()}
        case np.ndarray():
            return value.tolist()
        case list() | tuple():
            return [plain(inner) for inner in value]
        case _:
            return value

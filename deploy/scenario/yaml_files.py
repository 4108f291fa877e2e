"""YAML files with values that a schema checks, and what to say when some are wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times as fast where it is there


class InputError(Exception):
    """What the user gave cannot be used; the message says what, and what is allowed."""


class ScenarioError(InputError):
    """A scenario cannot be used; the message names file, key, value and what is allowed."""


def read_yaml(path: Path) -> dict[str, Any]:
    """A YAML file that holds a mapping.

    Raises:
        ScenarioError: it cannot be read, or holds something else.
    """
    try:
        values = yaml.load(path.read_text(), Loader=_LOADER)
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ScenarioError(f"{path}: cannot be read as YAML: {error}") from error
    if not isinstance(values, dict):
        raise ScenarioError(f"{path}: must be a mapping of keys to values")
    return values


def parse_override(override: str) -> tuple[str, Any]:
    """Dotted key and YAML value of ``dotted.key=value``.

    Raises:
        ScenarioError: it is not of that form.
    """
    key, separator, text = override.partition("=")
    if not separator or not key:
        raise ScenarioError(f"--set {override}: the form is dotted.key=value")
    try:
        return key, yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ScenarioError(f"--set {override}: {text!r} is no YAML value") from error


def override(values: dict[str, Any], text: str) -> None:
    """Set one value of a file by ``dotted.key=value``.

    Raises:
        ScenarioError: it is not of that form.
    """
    key, value = parse_override(text)
    *sections, last = key.split(".")
    for section in sections:
        inner = values.setdefault(section, {})
        if not isinstance(inner, dict):
            inner = values[section] = {}
        values = inner
    values[last] = value


def explain(error: ValidationError, path: Path) -> str:
    """What is wrong with the values of a file: key, value and what is allowed, a line each."""
    lines = []
    for problem in error.errors(include_url=False):
        key = ".".join(str(part) for part in problem["loc"])
        message = problem["msg"].removeprefix("Value error, ")
        if problem["type"] == "extra_forbidden":
            lines.append(f"{path}: {key}: there is no such key")
        elif problem["type"] == "missing":
            lines.append(f"{path}: {key}: is missing")
        else:
            allowed = message.removeprefix("Input should be ")
            lines.append(f"{path}: {key} = {problem['input']!r}: must be {allowed}")
    return "\n".join(lines)

"""Scenarios: one description for controller, plant, recorder and judge.

A scenario is a YAML file. All its errors are found here, before any process starts, and reported
with file, key, value and what is allowed.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Any

from bus_schema.configuration import ConfigurationError, shown
from bus_schema.errors import RobotDescriptionError
from bus_schema.robot_description import load_robot
from controller.law_choice import PROCESS
from deploy.scenario.base_units import in_base_units
from deploy.scenario.checking.checks import check
from deploy.scenario.checking.explanation import Origin
from deploy.scenario.checking.foreign_code import name_code
from deploy.scenario.definition import ScenarioConfiguration
from deploy.scenario.setup import Setup
from deploy.scenario.starter import ARM_FILES, starter_scenario
from deploy.scenario.xacro_arguments import split_arguments
from deploy.scenario.yaml_files import (
    ScenarioError,
    find_yaml,
    naming,
    parse_override,
    read_yaml,
    set_value,
    validated,
)

SHIPPED = Path(str(resources.files("deploy").joinpath("scenarios")))


def load_setup(
    name_or_path: str, overrides: Sequence[str] = (), given_by: str = "--set",
    *, creates_sides: bool = True,
) -> Setup:  # fmt: skip
    """Load, override and check a scenario.

    Args:
        name_or_path: a scenario file, or the name of a shipped scenario, or the URDF, xacro or MJCF
            file of an arm, which gets a `starter_scenario`; arguments of xacro may follow it.
        overrides: ``dotted.key=value``; values are YAML.
        given_by: what they were set with, for messages.
        creates_sides: as for `check`; false where a run has been made with the same values.

    Raises:
        ScenarioError: anything about it is wrong.
    """
    path, values = named_values(name_or_path)
    return build_setup(values, path, overrides, given_by, creates_sides=creates_sides)


def named_values(name_or_path: str) -> tuple[Path, dict[str, Any]]:
    """Return the file of a scenario as `load_setup` finds it, and its values.

    Raises:
        ScenarioError: there is none, or it cannot be read.
    """
    file, arguments = split_arguments(name_or_path)
    path = find_yaml(file, SHIPPED)
    return path, file_values(path, arguments)


def file_values(path: Path, arguments: Mapping[str, str] = MappingProxyType({})) -> dict[str, Any]:
    """Return the values of a scenario file, or of the starter scenario of an arm's file.

    Args:
        path: the file.
        arguments: values of the arguments of a xacro file, by name.

    Raises:
        ScenarioError: it cannot be read.
    """
    if path.suffix.lower() not in ARM_FILES and not arguments:
        return read_yaml(path)
    try:
        return starter_scenario(load_robot(path, arguments=arguments, hold_grippers=True))
    except RobotDescriptionError as error:
        raise ScenarioError(str(error)) from error


def build_setup(
    values: Mapping[str, Any], source: Path, overrides: Sequence[str] = (),
    given_by: str = "--set", *, creates_sides: bool = True,
) -> Setup:  # fmt: skip
    """Override and check the values of a scenario.

    Args:
        values: values in the form of its YAML file.
        source: that file, or a name for it; relative paths start beside it.
        overrides: ``dotted.key=value``; values are YAML.
        given_by: what they were set with, for messages.
        creates_sides: as for `check`.

    Raises:
        ScenarioError: anything about it is wrong.
    """
    origin = Origin(source, tuple(overrides), given_by)
    scenario = validated(given_values(values, source, overrides), ScenarioConfiguration, origin)
    name_code(scenario, origin)
    with naming(origin):
        scenario = _with_judged_period(scenario, origin)
    return check(scenario, origin, creates_sides=creates_sides)


def _with_judged_period(scenario: ScenarioConfiguration, origin: Origin) -> ScenarioConfiguration:
    """Return the scenario with a period over which errors are judged.

    The default may begin after the end of a short run, whose second half is then judged. This
    follows from its duration, and is not written into files, unlike a chosen value.
    """
    judge, end_s = scenario.metrics, scenario.duration_s
    is_chosen = judge.from_s != type(judge).model_fields["from_s"].default
    if judge.from_s < end_s:
        return scenario
    if is_chosen or origin.of("metrics.from_s") != str(origin.file):
        allowed = f"must be before the end of the run, {end_s:g} s"
        raise ConfigurationError("metrics.from_s", judge.from_s, allowed, ["duration_s"])
    chosen = judge.model_fields_set - {"from_s"}
    second_half = judge.model_construct(chosen, **{**dict(judge), "from_s": 0.5 * end_s})
    return scenario.model_copy(update={"metrics": second_half})


def given_values(
    values: Mapping[str, Any], source: Path, overrides: Sequence[str]
) -> dict[str, Any]:
    """Return all given values of a scenario, with those it extends and overrides; unchecked."""
    given, before = _extended(values, source), list[str]()
    for text in overrides:
        before.append(_override(given, text, before))
    return in_base_units(given)


def _override(values: dict[str, Any], text: str, before: Sequence[str]) -> str:
    """Set a value; a law replaces a process that was given before it.

    Another kind of reference replaces all of the file's but what was overridden `before`. Returns
    the key.
    """
    key, value = parse_override(text)
    given = values.get("reference")
    if key == "reference.kind" and isinstance(given, dict) and given.get("kind") != value:
        own = {each.split(".")[1] for each in before if each.startswith("reference.")}
        values["reference"] = {name: each for name, each in given.items() if name in own}
    set_value(values, key, value)
    if key == "controller.law" and value != PROCESS and "process" in values["controller"]:
        set_value(values, "controller.process", None)
    return key


def _extended(given: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """Return the values of a scenario with those of the scenarios that it ``extends`` in turn."""
    values, chain = copy.deepcopy(dict(given)), [path.resolve()]
    while (base := values.pop("extends", None)) is not None:
        file = chain[-1] if len(chain) > 1 else path
        if not isinstance(base, str):
            allowed = "must be the name or path of a scenario"
            raise ScenarioError(f"{file}: extends = {shown(base)}: {allowed}")
        try:
            found = find_yaml(base, SHIPPED, file.parent).resolve()
        except ScenarioError as error:
            raise ScenarioError(*error.lines(f"{file}: extends = ")) from error
        if found in chain:
            circle = " extends ".join(each.name for each in [*chain[chain.index(found) :], found])
            raise ScenarioError(f"{file}: extends = {shown(base)}: must be no circle: {circle}")
        chain.append(found)
        values = _merged(read_yaml(found), values)
    return values


def _merged(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in over.items():
        both = isinstance(value, dict) and isinstance(base.get(key), dict)
        both = both and not (key == "reference" and _is_of_another_kind(value, base[key]))
        merged[key] = _merged(base[key], value) if both else value
    return merged


def _is_of_another_kind(section: Mapping[str, Any], than: Mapping[str, Any]) -> bool:
    """Whether the keys of a section belong to another kind than those of the other section."""
    return "kind" in section and section["kind"] != than.get("kind")

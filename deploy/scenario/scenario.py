"""Scenarios: the one description that controller, plant, recorder and judge all read.

A scenario is a YAML file. Everything that can be wrong with it is found here, before any process
starts, and told with file, key, value and what is allowed.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from bus_schema.arrays import Matrix
from bus_schema.configuration import (
    ConfigurationError,
    expand,
    shown,
)
from bus_schema.errors import RobotDescriptionError
from bus_schema.limits import LimitsConfiguration
from bus_schema.robot_description import RobotDescription, load_robot
from bus_schema.runtime.clock import TickGrid
from controller.configuration import PROCESS, ControllerConfiguration
from controller.laws import LAWS
from controller.reference import Reference, sample_positions
from deploy.link_kinds.table import LINK_KINDS
from deploy.scenario.definition import Scenario
from deploy.scenario.explanation import Origin
from deploy.scenario.referenced_files import find_delay_files, find_reference_file, find_urdf
from deploy.scenario.setup import Setup
from deploy.scenario.uncertainty import check_uncertainty
from deploy.scenario.yaml_files import (
    ScenarioError,
    find_yaml,
    naming,
    parse_override,
    plain,
    read_yaml,
    set_value,
    to_yaml,
    validated,
)
from plant_emulator.arm.arm_plant import ArmPlant
from plant_emulator.configuration import PlantConfiguration
from plant_emulator.drives.protocol import PROTOCOLS
from plant_emulator.faults.fault import FaultContext
from plant_emulator.faults.kinds import check_faults

SHIPPED = Path(str(resources.files("deploy").joinpath("scenarios")))
_CHECKED_PER_SECOND = 100
_MOST_CHECKED = 20_000
_SIZED_BY = 100


def load_setup(name_or_path: str, overrides: Sequence[str] = (), given_by: str = "--set") -> Setup:
    """Load, override and check a scenario.

    Args:
        name_or_path: a scenario file, or the name of a shipped scenario.
        overrides: ``dotted.key=value``; values are YAML.
        given_by: what they were set with, for messages.

    Raises:
        ScenarioError: anything about it is wrong.
    """
    path = find_yaml(name_or_path, SHIPPED)
    return build_setup(read_yaml(path), path, overrides, given_by)


def build_setup(
    values: Mapping[str, Any], source: Path, overrides: Sequence[str] = (), given_by: str = "--set"
) -> Setup:
    """Override and check the values of a scenario.

    Args:
        values: as its YAML file has them, or would.
        source: that file, or what to call it; relative paths start beside it.
        overrides: ``dotted.key=value``; values are YAML.
        given_by: what they were set with, for messages.

    Raises:
        ScenarioError: anything about it is wrong.
    """
    origin = Origin(source, tuple(overrides), given_by)
    scenario = validated(given_values(values, source, overrides), Scenario, origin)
    with naming(origin):
        scenario = _judged_over_some_time(scenario, origin)
    return check(scenario, origin)


def effective_scenario(setup: Setup, files: Mapping[str, str] = MappingProxyType({})) -> str:
    """`effective_values` as YAML.

    Args:
        setup: the scenario.
        files: paths to write, by dotted key, in place of absolute ones.
    """
    values = effective_values(setup)
    for key, path in files.items():
        set_value(values, key, path)
    return to_yaml(values)


def effective_values(setup: Setup) -> dict[str, Any]:
    """The scenario in force: defaults, overrides, and what follows from the arm; paths absolute.

    But for endpoints, CAN buses and a time to judge from that nobody chose: who runs it again may
    choose others, or another duration.
    """
    given = setup.scenario
    values: dict[str, Any] = plain(
        given.model_copy(
            update={
                "controller": _with_gains(setup),
                "limits": _with_limits(setup),
                "plant": _with_drives(setup),
            }
        )
    )
    values["robot"]["urdf"] = str(setup.robot.path)
    for key in {"plant_endpoint", "controller_endpoint"} - given.link.model_fields_set:
        del values["link"][key]
    if "from_s" not in given.metrics.model_fields_set:
        del values["metrics"]["from_s"]
    for key in {"channel", "port"} - given.link.can.model_fields_set:
        values["link"]["can"].pop(key, None)
    return values


def _with_gains(setup: Setup) -> ControllerConfiguration:
    controller = setup.scenario.controller
    if controller.law not in LAWS:
        return controller
    gains = {**controller.gains, controller.law: setup.gains}
    ordered = {law: gains[law] for law in (*LAWS, *gains) if law in gains}
    return controller.model_copy(update={"gains": ordered})


def _with_limits(setup: Setup) -> LimitsConfiguration:
    limits = setup.scenario.limits
    in_force = limits.of_plant(setup.robot)
    known = {
        name: limit
        for name in ("torque_nm", "velocity_rad_s", "torque_rate_nm_s")
        if np.isfinite(limit := getattr(in_force, name)).all()  # no file says that there is none
    }
    return limits.model_copy(update=known)


def _with_drives(setup: Setup) -> PlantConfiguration:
    plant, drive = setup.scenario.plant, setup.drive
    if not drive.is_active:
        return plant
    loop = {"stiffness_nm_rad": drive.stiffness_nm_rad, "damping_nm_s": drive.damping_nm_s}
    return plant.model_copy(update={"drive_feedback": plant.drive_feedback.model_copy(update=loop)})


def _judged_over_some_time(scenario: Scenario, origin: Origin) -> Scenario:
    """The scenario with errors summed up over some time.

    The default may lie beyond the end of a short run, of which the second half counts then: that
    follows from its duration, and is not written into files, as what is chosen is.
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
    """All that a scenario says, of what it extends too, and what is set beside it; unchecked."""
    given = _extended(values, source)
    for text in overrides:
        _override(given, text)
    return given


def _override(values: dict[str, Any], text: str) -> None:
    """Set a value; a law takes the place of a process that was given before it."""
    key, value = parse_override(text)
    set_value(values, key, value)
    if key == "controller.law" and value != PROCESS and "process" in values["controller"]:
        set_value(values, "controller.process", None)


def _extended(given: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """The values of a scenario; one that ``extends`` another says only what is different."""
    values = copy.deepcopy(dict(given))
    base = values.pop("extends", None)
    if base is None:
        return values
    if not isinstance(base, str):
        allowed = "must be the name or path of a scenario"
        raise ScenarioError(f"{path}: extends = {shown(base)}: {allowed}")
    try:
        base_path = find_yaml(base, SHIPPED, path.parent)
    except ScenarioError as error:
        raise ScenarioError(f"{path}: extends = {error}") from error
    base_values = read_yaml(base_path)
    if "extends" in base_values:
        raise ScenarioError(f"{path}: extends = {base!r}: must be a scenario that extends no other")
    return _merged(base_values, values)


def _merged(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in over.items():
        both = isinstance(value, dict) and isinstance(base.get(key), dict)
        both = both and not (key == "reference" and _is_of_another_kind(value, base[key]))
        merged[key] = _merged(base[key], value) if both else value
    return merged


def _is_of_another_kind(section: Mapping[str, Any], than: Mapping[str, Any]) -> bool:
    """Whether the keys of a section cannot go with those of another, as they differ in kind."""
    return "kind" in section and section["kind"] != than.get("kind")


def check(scenario: Scenario, origin: Origin) -> Setup:
    """Check a scenario against the files and the robot it refers to.

    Raises:
        ScenarioError: something does not fit.
    """
    with naming(origin):
        try:
            return _check(scenario, origin)
        except RobotDescriptionError as error:
            raise ConfigurationError("robot.urdf", scenario.robot.urdf, str(error)) from error


def _check(scenario: Scenario, origin: Origin) -> Setup:
    source = origin.file
    link_kind = LINK_KINDS.build(scenario.link.kind)
    PROTOCOLS.check(scenario.link.can.protocol)
    given = scenario.robot
    robot = load_robot(find_urdf(given.urdf, source.parent), given.joints, repair=given.repair)
    reference_section = find_reference_file(scenario.reference, source.parent)
    reference = reference_section.build(robot)
    grid = TickGrid(scenario.rate_hz, scenario.plant.substeps)
    if scenario.duration_s * 1e9 < grid.period_ns:
        allowed = f"at least a tick, {grid.period_ns * 1e-9} s"
        raise ConfigurationError("duration_s", scenario.duration_s, allowed, ["rate_hz"])
    key = "robot.initial_offset_rad"
    offset = expand(scenario.robot.initial_offset_rad, robot.joints, key)
    motion = _reachable_motion(reference, robot, scenario)
    start = sample_positions(reference, np.zeros(1), robot.joints)[0] + offset
    if np.any(start < robot.lower_rad) or np.any(start > robot.upper_rad):
        allowed = f"the start {np.round(start, 4).tolist()} must lie within the joint limits"
        allowed = f"{allowed} {_ranges(robot)}"
        raise ConfigurationError(key, offset.tolist(), allowed, ["reference", "robot"])
    context = FaultContext(
        robot.joint_names, scenario.duration_s, scenario.plant.payload_kg, link_kind.no_link_faults
    )
    check_faults(scenario.faults, context)
    sized_by = motion[:: -(-len(motion) // _SIZED_BY)]
    inertia = scenario.controller.nominal_model(robot).governing_inertia(sized_by)
    link = find_delay_files(scenario.link, source.parent)
    setup = Setup(
        scenario=scenario.model_copy(update={"link": link, "reference": reference_section}),
        source=source,
        robot=robot,
        reference=reference,
        funnel=scenario.funnel.build(offset),
        gains=scenario.controller.build_gains(robot, inertia),
        start_position_rad=start,
        governing_inertia_kg_m2=inertia,
        grid=grid,
        overrides=tuple(origin.overrides),
        given_by=origin.given_by,
    )
    if scenario.controller.process is None:
        setup.control_task()
    elif scenario.link.kind != "zenoh":
        allowed = "must be zenoh, which controller.process speaks"
        raise ConfigurationError("link.kind", scenario.link.kind, allowed, ["controller.process"])
    link_kind.check(setup.link_run(lockstep=True))
    ArmPlant.check(scenario.plant, robot, grid, scenario.limits)
    if scenario.uncertainty:
        check_uncertainty(scenario.uncertainty, plain(scenario), robot.joints)
    return setup


def _reachable_motion(reference: Reference, robot: RobotDescription, scenario: Scenario) -> Matrix:
    """Reference positions over the run, shape (samples, joints), all within the arm's reach."""
    first_s, last_s = reference.known_s
    if first_s > 0.0 or last_s < scenario.duration_s - 0.5 / scenario.rate_hz:
        allowed = (
            f"must be within the {first_s:g} to {last_s:g} s of reference.file; reference.beyond:"
            " hold rests before and after"
        )
        raise ConfigurationError("duration_s", scenario.duration_s, allowed, ["reference"])
    samples = min(round(scenario.duration_s * _CHECKED_PER_SECOND), _MOST_CHECKED) + 1
    times = np.linspace(0.0, scenario.duration_s, samples)
    positions = sample_positions(reference, times, robot.joints)
    outside = ~((positions >= robot.lower_rad) & (positions <= robot.upper_rad)).all(axis=1)
    if outside.any():
        first = int(np.argmax(outside))
        what = np.round(positions[first], 4).tolist()
        raise ConfigurationError(
            "reference",
            f"{what} at {times[first]:g} s",
            f"must stay within the arm's reach and joint limits {_ranges(robot)}",
            ["duration_s", "robot"],
        )
    return positions


def _ranges(robot: RobotDescription) -> str:
    ends = zip(robot.lower_rad, robot.upper_rad, strict=True)
    return ", ".join(f"[{lower:.4g}, {upper:.4g}]" for lower, upper in ends)

"""Checks of a scenario against its files and its arm, with warnings for suspicious ones."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.can.protocol import PROTOCOLS
from bus_schema.configuration import ConfigurationError, expand
from bus_schema.eigenvalues import eigenvalues
from bus_schema.errors import JointNameError, RobotDescriptionError
from bus_schema.link.can_configuration import CanConfiguration
from bus_schema.robot_description import RobotDescription, load_robot
from bus_schema.runtime.clock import TickGrid
from controller.laws.custom import are_left_out
from controller.manipulator_model import ManipulatorModel, largest_load_kg
from controller.reference import Reference, sample_positions
from deploy.scenario.checking.explanation import Origin
from deploy.scenario.definition import RobotConfiguration, ScenarioConfiguration
from deploy.scenario.link_kinds.kind import LINK_KINDS
from deploy.scenario.referenced_files import (
    find_delay_files,
    find_nominal,
    find_reference_file,
    find_urdf,
    folders_of,
)
from deploy.scenario.robot_interface import check_interface
from deploy.scenario.setup import Setup
from deploy.scenario.uncertainty import check_uncertainty
from deploy.scenario.yaml_files import naming, plain
from plant_emulator.arm_plant import ArmPlant
from plant_emulator.drives.commissioning import drive_of
from plant_emulator.faults.fault import FaultContext
from plant_emulator.faults.kinds import check_faults
from plant_emulator.physics.engines import ENGINES

_CHECKED_PER_SECOND = 100
_MOST_SECONDS = 200
_PER_PERIOD = 8
_HIDDEN_SHARE = 0.25
"""Of the funnel's final size, by which a recorded reference may move unseen between two ticks."""
_SIZED_BY = 100


def check(scenario: ScenarioConfiguration, origin: Origin, *, creates_sides: bool = True) -> Setup:
    """Check a scenario against the files and the robot it refers to.

    Args:
        scenario: the scenario.
        origin: where its values are from.
        creates_sides: whether to create its controller, link and plant once, which most loads need.

    Raises:
        ScenarioError: something does not fit.
    """
    with naming(origin):
        try:
            setup = _set_up(scenario, origin)
            if creates_sides:
                _check_sides(setup)
        except JointNameError as error:
            raise ConfigurationError("robot.joints", scenario.robot.joints, str(error)) from error
        except RobotDescriptionError as error:
            raise ConfigurationError("robot.urdf", scenario.robot.urdf, str(error)) from error
    return setup


def _set_up(scenario: ScenarioConfiguration, origin: Origin) -> Setup:
    link_kind = LINK_KINDS[scenario.link.kind]()
    _check_protocol(scenario.link.can)
    if (engine := scenario.plant.physics.engine) is not None:
        _ = ENGINES[engine]
    if scenario.plant.interface.has_controller:
        _ = scenario.plant.interface.settings
    given = scenario.robot
    folders = folders_of("robot.urdf", origin)
    robot = load_robot(find_urdf(given.urdf, *folders), **reading(given, folders[0]))
    reference_section = find_reference_file(scenario.reference, origin)
    reference = reference_section.build(robot)
    robot = replace(robot, base_rpy_rad=given.base_rpy_rad)  # paths are in the base's frame
    nominal, controller = find_nominal(scenario, robot, origin)
    nominal = replace(nominal, base_rpy_rad=given.base_rpy_rad)
    scenario = scenario.model_copy(update={"controller": controller})
    grid = _grid(scenario)
    motion = _reachable_motion(reference, robot, scenario)
    offset, start = _start(reference, robot, given.initial_offset_rad)
    scenario = _in_numbers(scenario, robot, start, grid)
    context = FaultContext(
        robot.joint_names, scenario.duration_s, scenario.plant.payload_kg,
        link_kind.no_link_faults, scenario.link.no_duplicates,
    )  # fmt: skip
    check_faults(scenario.faults, context)
    sized_by = motion[:: -(-len(motion) // _SIZED_BY)]
    rotors = scenario.plant.actuator.rotor_inertia(robot.joints)
    _check_gears(scenario, robot, sized_by, grid)
    inertia = scenario.controller.nominal_model(nominal, rotors).governing_inertia(sized_by)
    link = find_delay_files(scenario, origin)
    return Setup(
        scenario=scenario.model_copy(update={"link": link, "reference": reference_section}),
        source=origin.file,
        robot=robot,
        nominal=nominal,
        reference=reference,
        funnel=scenario.funnel.build(offset),
        gains=scenario.controller.build_gains(robot, inertia),
        start_position_rad=start,
        governing_inertia_kg_m2=inertia,
        grid=grid,
        overrides=tuple(origin.overrides),
        given_by=origin.given_by,
    )


def _check_protocol(can: CanConfiguration) -> None:
    """Check protocol and drives of a package, and settings, whether or not the link is CAN.

    Others are imported, which is slow, only where the link is CAN.
    """
    PROTOCOLS.check(can.protocol)
    if can.settings is not None or PROTOCOLS.extension(can.protocol) is not None:
        PROTOCOLS[can.protocol]().settings(can)
        drive_of(can.protocol)


def reading(given: RobotConfiguration, folder: Path) -> dict[str, Any]:
    """Return how `load_robot` reads an arm's file.

    Args:
        given: the section ``robot``.
        folder: the folder from which relative paths start.
    """
    return {
        "driven": given.joints,
        "repair": given.repair,
        "arguments": given.xacro or {},
        "include": [(folder / each).resolve() for each in given.include or ()],
        "mass_kg": given.mass_kg,
        "hold": given.hold or {},
    }


def _check_gears(
    scenario: ScenarioConfiguration, robot: RobotDescription, positions: Matrix, grid: TickGrid
) -> None:
    """Check that a physics step is short compared with the oscillation of rotors against links."""
    stiffness = scenario.plant.actuator.gear_stiffness_nm_rad
    rotors = scenario.plant.actuator.rotor_inertia(robot.joints)
    if stiffness is None or not rotors.all():
        return
    links = ManipulatorModel(robot).governing_inertia(positions)
    most = 1.0 / (1.0 / rotors + 1.0 / links) / grid.substep_s**2
    if (stiffness > most).any():
        allowed = (
            f"must be at most {[float(f'{each:.3g}') for each in most]} with this arm and physics"
            f" step of {1e3 * grid.substep_s:g} ms; a larger plant.substeps raises this limit"
        )
        key = "plant.actuator.gear_stiffness_nm_rad"
        raise ConfigurationError(key, stiffness.tolist(), allowed, ["plant.substeps", "robot"])


def _in_numbers(
    scenario: ScenarioConfiguration, robot: RobotDescription, start: Vector, grid: TickGrid
) -> ScenarioConfiguration:
    """Return the scenario with payload and gears as numbers where they are relative to the arm."""
    plant = scenario.plant
    rated = plant.actuator.saturation_nm
    rated = robot.effort_limits_nm if rated is None else rated
    changes: dict[str, object] = {}
    if plant.payload_share:
        payload_kg = plant.payload_kg + plant.payload_share * largest_load_kg(robot, rated)
        changes = {"payload_kg": payload_kg, "payload_share": 0.0}
    if (first_hz := plant.actuator.gear_resonance_hz) is not None:
        stiffness = _gear_stiffness(robot, rated, start, first_hz, grid)
        update = {"gear_resonance_hz": None, "gear_stiffness_nm_rad": stiffness}
        changes["actuator"] = plant.actuator.model_copy(update=update)
    if not changes:
        return scenario
    return scenario.model_copy(update={"plant": plant.model_copy(update=changes)})


def _gear_stiffness(
    robot: RobotDescription, rated: Vector, start: Vector, first_hz: float, grid: TickGrid
) -> Vector:
    """Return the stiffness for the first resonance, reduced if a physics step is too long for it.

    Raises:
        ConfigurationError: the largest torques, to which it is proportional, are unknown.
    """
    if not np.isfinite(rated).all():
        allowed = "must be left out if neither the URDF nor saturation_nm gives the largest torques"
        raise ConfigurationError("plant.actuator.gear_resonance_hz", first_hz, allowed)
    model = ManipulatorModel(robot)
    root = np.sqrt(np.broadcast_to(rated, robot.joints))
    slowest_s2 = eigenvalues(model.mass_matrix(start) / np.outer(root, root))[0].max()
    wanted = root**2 * (2.0 * math.pi * first_hz) ** 2 * slowest_s2
    most = 0.2 * model.governing_inertia(start[None]) / grid.substep_s**2
    return np.asarray(np.minimum(wanted, most))


def _check_sides(setup: Setup) -> None:
    """Check that controller, link and plant can be created from a scenario."""
    scenario, _ = setup.scenario, setup.link  # which is checked when it is read
    check_interface(setup)
    if scenario.controller.process is None:
        setup.control_task()
    elif scenario.link.kind != "zenoh":
        allowed = "must be zenoh, because controller.process communicates over Zenoh"
        raise ConfigurationError("link.kind", scenario.link.kind, allowed, ["controller.process"])
    most = int(scenario.plant.command_timeout_ms * 1e6 // setup.grid.period_ns)
    if setup.answer_every > max(1, most):
        allowed = f"at most {most}, else plant.command_timeout_ms passes between two answers"
        also = ["controller.process", "plant.command_timeout_ms"]
        raise ConfigurationError("controller.every", setup.answer_every, allowed, also)
    setup.link_kind.check(setup.link_run(lockstep=scenario.clock == "lockstep"))
    if not are_left_out():  # a scenario that is only viewed needs no physics engine
        check_plant(setup)
    if scenario.uncertainty:
        check_uncertainty(scenario.uncertainty, plain(scenario), setup.robot.joints)


def check_plant(setup: Setup) -> None:
    """Check that a physics engine can load the arm.

    Raises:
        RobotDescriptionError: it cannot.
        ConfigurationError: the plant's settings do not fit the arm.
    """
    scenario = setup.scenario
    ArmPlant.check(scenario.plant, setup.robot, setup.grid, scenario.limits)


def _grid(scenario: ScenarioConfiguration) -> TickGrid:
    grid = TickGrid(scenario.rate_hz, scenario.plant.substeps)
    if scenario.duration_s * 1e9 < grid.period_ns:
        allowed = f"at least a tick, {grid.period_ns * 1e-9} s"
        raise ConfigurationError("duration_s", scenario.duration_s, allowed, ["rate_hz"])
    return grid


def _start(
    reference: Reference, robot: RobotDescription, offset_rad: Vector
) -> tuple[Vector, Vector]:
    """Return the joints' offset from the reference at the start, and their position, (joints,)."""
    key = "robot.initial_offset_rad"
    offset = expand(offset_rad, robot.joints, key)
    start = sample_positions(reference, np.zeros(1), robot.joints)[0] + offset
    if np.any(start < robot.lower_rad) or np.any(start > robot.upper_rad):
        allowed = f"the start {np.round(start, 4).tolist()} must lie within the joint limits"
        allowed = f"{allowed} {_ranges(robot)}"
        raise ConfigurationError(key, offset.tolist(), allowed, ["reference", "robot"])
    return offset, start


def _reachable_motion(
    reference: Reference, robot: RobotDescription, scenario: ScenarioConfiguration
) -> Matrix:
    """Return reference positions over the run, shape (samples, joints); all must be in reach."""
    first_s, last_s = reference.known_s
    if first_s > 0.0 or last_s < scenario.duration_s - 0.5 / scenario.rate_hz:
        allowed = (
            f"must be within the {first_s:g} to {last_s:g} s of reference.file; or set"
            " reference.beyond: hold to rest before and after"
        )
        raise ConfigurationError("duration_s", scenario.duration_s, allowed, ["reference"])
    highest_hz, rate_hz = scenario.reference.highest_hz, scenario.rate_hz
    if math.isfinite(highest_hz) and highest_hz >= 0.5 * rate_hz * (1.0 - 1e-9):
        allowed = f"must be below half of rate_hz = {rate_hz:g}, because no tick shows more"
        raise ConfigurationError("reference", f"{highest_hz:g} Hz", allowed, ["rate_hz"])
    if (per_second := min(rate_hz, _PER_PERIOD * highest_hz)) > _CHECKED_PER_SECOND:
        _positions_in_reach(reference, robot, scenario, per_second)
    if not math.isfinite(highest_hz) and scenario.duration_s <= _MOST_SECONDS:
        _require_visible(_positions_in_reach(reference, robot, scenario, 4.0 * rate_hz), scenario)
    return _positions_in_reach(reference, robot, scenario, _CHECKED_PER_SECOND)


def _require_visible(positions: Matrix, scenario: ScenarioConfiguration) -> None:
    """Check that a recorded reference moves little between two ticks, where no law sees it.

    Args:
        positions: at each quarter of a tick.
        scenario: for its funnel.
    """
    ticks = (len(positions) - 1) // 4
    quarters = positions[: 4 * ticks].reshape(ticks, 4, -1)
    step = positions[4 : 4 * ticks + 1 : 4] - quarters[:, 0]
    between = quarters - quarters[:, :1] - np.arange(4)[:, None] / 4.0 * step[:, None]
    between = np.take_along_axis(between, np.abs(between).argmax(axis=1)[:, None], axis=1)[:, 0]
    hidden = np.abs(between) > _HIDDEN_SHARE * np.asarray(scenario.funnel.final_rad)
    if hidden.any():
        tick, joint = np.argwhere(hidden)[0]
        allowed = (
            f"must move less between two ticks of rate_hz = {scenario.rate_hz:g} than"
            f" {_HIDDEN_SHARE:g} of the funnel: its content lies above half of the rate"
        )
        what = f"{between[tick, joint]:.3g} rad beside joint {joint + 1}'s ticks at"
        raise ConfigurationError(
            "reference.file", f"{what} {tick / scenario.rate_hz:g} s", allowed, ["rate_hz"]
        )


def _positions_in_reach(
    reference: Reference, robot: RobotDescription, scenario: ScenarioConfiguration, per_s: float
) -> Matrix:
    """Return so many reference positions per second; raises if one is out of reach."""
    samples = min(round(scenario.duration_s * per_s), round(_MOST_SECONDS * per_s)) + 1
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

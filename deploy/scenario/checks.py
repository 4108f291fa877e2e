"""Checks of a scenario against its files and its arm, with warnings for suspicious ones."""

from __future__ import annotations

import math

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.can.protocol import PROTOCOLS
from bus_schema.configuration import ConfigurationError, expand
from bus_schema.eigenvalues import eigenvalues
from bus_schema.errors import JointNameError, RobotDescriptionError
from bus_schema.robot_description import RobotDescription, load_robot
from bus_schema.runtime.clock import TickGrid
from controller.laws.custom import are_left_out
from controller.manipulator_model import ManipulatorModel, largest_load_kg
from controller.reference import Reference, sample_positions
from deploy.scenario.definition import ScenarioConfiguration
from deploy.scenario.explanation import Origin
from deploy.scenario.link_kinds.kind import LINK_KINDS
from deploy.scenario.referenced_files import (
    find_delay_files,
    find_reference_file,
    find_urdf,
    folders_of,
)
from deploy.scenario.setup import Setup
from deploy.scenario.uncertainty import check_uncertainty
from deploy.scenario.yaml_files import naming, plain
from plant_emulator.arm_plant import ArmPlant
from plant_emulator.faults.fault import FaultContext
from plant_emulator.faults.kinds import check_faults

_CHECKED_PER_SECOND = 100
_MOST_CHECKED = 20_000
_SIZED_BY = 100


def check(scenario: ScenarioConfiguration, origin: Origin) -> Setup:
    """Check a scenario against the files and the robot it refers to.

    Raises:
        ScenarioError: something does not fit.
    """
    with naming(origin):
        try:
            setup = _set_up(scenario, origin)
            _check_sides(setup)
        except JointNameError as error:
            raise ConfigurationError("robot.joints", scenario.robot.joints, str(error)) from error
        except RobotDescriptionError as error:
            raise ConfigurationError("robot.urdf", scenario.robot.urdf, str(error)) from error
    return setup


def _set_up(scenario: ScenarioConfiguration, origin: Origin) -> Setup:
    link_kind = LINK_KINDS.build(scenario.link.kind)
    PROTOCOLS.check(scenario.link.can.protocol)
    given = scenario.robot
    urdf = find_urdf(given.urdf, *folders_of("robot.urdf", origin))
    robot = load_robot(urdf, given.joints, repair=given.repair)
    reference_section = find_reference_file(scenario.reference, origin)
    reference = reference_section.build(robot)
    grid = _grid(scenario)
    motion = _reachable_motion(reference, robot, scenario)
    offset, start = _start(reference, robot, given.initial_offset_rad)
    scenario = _in_numbers(scenario, robot, start, grid)
    context = FaultContext(
        robot.joint_names, scenario.duration_s, scenario.plant.payload_kg, link_kind.no_link_faults
    )
    check_faults(scenario.faults, context)
    sized_by = motion[:: -(-len(motion) // _SIZED_BY)]
    rotors = scenario.plant.actuator.rotor_inertia(robot.joints)
    _check_gears(scenario, robot, sized_by, grid)
    inertia = scenario.controller.nominal_model(robot, rotors).governing_inertia(sized_by)
    link = find_delay_files(scenario, origin)
    return Setup(
        scenario=scenario.model_copy(update={"link": link, "reference": reference_section}),
        source=origin.file,
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
    scenario = setup.scenario
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
        ArmPlant.check(scenario.plant, setup.robot, setup.grid, scenario.limits)
    if scenario.uncertainty:
        check_uncertainty(scenario.uncertainty, plain(scenario), setup.robot.joints)


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

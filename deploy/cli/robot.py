"""The command `robot`: shows how the program reads an arm's file."""

from __future__ import annotations

import shlex
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from bus_schema.arrays import Vector
from bus_schema.errors import InputError, RobotDescriptionError
from bus_schema.robot_description import RobotDescription, load_robot
from bus_schema.urdf.chains import Chain, chains_of, chosen_joints
from bus_schema.urdf.checks import finite_number
from bus_schema.urdf.end_effectors import BESIDE
from bus_schema.urdf.implausible import telescope_warnings, tip_warnings
from controller.manipulator_model import ManipulatorModel
from deploy.cli.parts.options import IncludeOption, InterfaceOption, JointsOption, MassOption
from deploy.reports.tables import Column, Table, Value, number
from deploy.reports.terminal import print_table
from deploy.run.console import Console
from deploy.scenario.base_units import HELD, in_unit
from deploy.scenario.checking.checks import check, check_plant
from deploy.scenario.checking.explanation import Origin
from deploy.scenario.checking.plausibility import (
    damping_warnings,
    rotor_warnings,
    size_warnings,
    weak_joint_warnings,
)
from deploy.scenario.checking.warnings import estimated_rotor_warnings, scenario_warnings
from deploy.scenario.definition import ScenarioConfiguration
from deploy.scenario.interface_choice import interface_values
from deploy.scenario.referenced_files import find_urdf
from deploy.scenario.scenario import build_setup
from deploy.scenario.setup import Setup
from deploy.scenario.starter import actuator_values, drive_feedback, drives_of, starter_scenario
from deploy.scenario.xacro_arguments import split_arguments
from deploy.scenario.yaml_files import ScenarioError, set_value, to_yaml, validated

STARTER_COMMENT = """\
# A first scenario: rest to rest at 30 % of the joints' speeds. robot.drive_data names what is
# ESTIMATED (see the documentation of plant.actuator): replace it by your own data.
"""


def robot(
    file: Annotated[
        str,
        typer.Argument(
            metavar="FILE [NAME:=VALUE …]",
            help="A URDF, xacro or MJCF file, or other value of robot.urdf; xacro arguments.",
        ),
    ],
    joints: JointsOption = None,
    chain: Annotated[
        str | None,
        typer.Option(metavar="TIP", help="Drive the joints on the way to this link, hold others."),
    ] = None,
    hold: Annotated[
        str | None,
        typer.Option(metavar="JOINT=VALUE,…", help="Hold joints at positions, rad or m."),
    ] = None,
    repair: Annotated[
        bool, typer.Option("--repair", help="Replace inertias that no rigid body can have.")
    ] = False,
    include: IncludeOption = None,
    mass: MassOption = None,
    gains: Annotated[
        bool, typer.Option("--gains", help="Show the gains that follow from the inertias.")
    ] = False,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Draw the arm to this file.")
    ] = None,
    scenario: Annotated[
        bool, typer.Option("--scenario", help="Write a first scenario for the arm.")
    ] = False,
    interface: InterfaceOption = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.yaml", help="File for --scenario.", show_default=False),
    ] = None,
) -> None:
    """Show how an arm's file is read: joints, limits, inertias, gains and warnings."""
    chosen = None if joints is None else [name.strip() for name in joints.split(",")]
    file, arguments = split_arguments(file)
    folders = [folder.resolve() for folder in include or ()]
    try:
        path = find_urdf(file, Path.cwd())
        read = partial(
            load_robot, path, arguments=arguments, include=folders, mass_kg=mass, hold=_pose(hold),
            hold_grippers=True,
        )  # fmt: skip
        if chain is not None:
            whole = read(chosen, repair=True)
            chosen = chosen_joints(ET.fromstring(whole.text), _of_chains(whole), chain)
        arm = read(chosen, repair=repair)
    except RobotDescriptionError as error:
        text = str(error)
        raise ScenarioError(text if text.startswith("/") else f"{file}: {text}") from error
    setup = at_rest(arm)
    values = starter_scenario(arm)
    for key, value in interface_values(interface).items():
        set_value(values, key, value)
    try:
        check_plant(first := build_setup(values, arm.path))
    except RobotDescriptionError as error:  # as `simulate` would
        raise ScenarioError(str(error)) from error
    console = Console()
    console.print(f"{arm.path}: {arm.joints} driven joints, tip {arm.tip_link}", markup=False)
    print_table(console, _joints_table(setup))
    print_table(console, _inertia_table(first))
    if arm.followers or arm.held:
        print_table(console, _other_joints_table(arm))
    if len(chains := chains_of(ET.fromstring(arm.text), _of_chains(arm))) > 1:
        print_table(console, _chains_table(chains))
    if gains:
        print_table(console, _gains_table(first))
    print_table(console, _drives_table(arm))
    console.print(_funnel_line(setup), markup=False, highlight=False)
    for each in robot_warnings(setup):
        console.print(f"warning: {each}", style="yellow", markup=False, highlight=False)
    if picture is not None:
        from deploy.reports.figures.arm_pictures import arm_picture  # which is slow to import

        png = arm_picture(arm, setup.start_position_rad)
        try:
            picture.write_bytes(png)
        except OSError as error:
            why = f"cannot be written: {error.strerror}"
            raise InputError(f"--picture {picture}: {why}") from error
        console.print(f"picture: {picture}", soft_wrap=True)
    if scenario:
        write_starter(values, out or Path(f"{values['name']}.yaml"))


def _of_chains(arm: RobotDescription) -> list[str]:
    """Return the joints that a chain may have: those driven, and those beside the arm."""
    return [*arm.joint_names, *(each.name for each in arm.held if each.reason == BESIDE)]


def _pose(text: str | None) -> dict[str, float]:
    """Return positions of joints, by name, from ``JOINT=VALUE,…``."""
    pairs = [pair.partition("=") for pair in (text or "").split(",") if pair.strip()]
    try:
        return {
            name.strip(): finite_number(name, "--hold", str(in_unit(value, HELD)))
            for name, _, value in pairs
        }
    except RobotDescriptionError as error:
        raise InputError(f"--hold {text}: must be JOINT=VALUE,…, in rad or m: {error}") from error


def write_starter(values: dict[str, Any], file: Path) -> None:
    """Write a first scenario, and print the commands that run it.

    Raises:
        InputError: the file exists.
    """
    try:
        with file.open("x", encoding="utf-8") as stream:
            stream.write(STARTER_COMMENT + to_yaml(values))
    except OSError as error:
        why = f"cannot be written: {error.strerror}; --out names another"
        raise InputError(f"{file}: {why}") from error
    print(f"scenario: {file}\nfunnel-hil simulate {shlex.quote(str(file))} runs it")
    print(f"funnel-hil margin {shlex.quote(str(file))} finds how much delay it tolerates")


def at_rest(arm: RobotDescription, *, duration_s: float = 1.0) -> Setup:
    """Return a scenario in which the arm holds still, checked like any other.

    Args:
        arm: the arm.
        duration_s: of a run.

    Raises:
        ScenarioError: no scenario could run this arm.
    """
    origin = Origin(arm.path)
    rest = {"time_s": 0.0, "position_rad": _middle(arm).tolist()}
    values = {
        "name": "robot",
        "duration_s": duration_s,
        "robot": {"urdf": str(arm.path), **arm.reading},
        "reference": {"kind": "minimum_jerk", "waypoints": [rest]},
        "plant": {"actuator": {}},  # the arm alone: a table shows what is estimated of its drives
        "metrics": {"from_s": 0.5 * duration_s},
    }
    return check(validated(values, ScenarioConfiguration, origin), origin)


def robot_warnings(setup: Setup) -> list[str]:
    """Return warnings about an arm at rest and its file, a sentence each."""
    arm = setup.robot
    return [
        *scenario_warnings(setup),
        *estimated_rotor_warnings(setup),
        *tip_warnings(ET.fromstring(arm.text), arm.tip_link, arm.joint_names),
        *telescope_warnings(ET.fromstring(arm.text), arm.joint_names),
        *weak_joint_warnings(arm),
        *rotor_warnings(arm),
        *size_warnings(arm),
        *damping_warnings(arm, arm.drives.damping_nm_s, drives_of(arm).rated),
    ]


def _middle(arm: RobotDescription) -> Vector:
    """Return zero for ranges that contain it, otherwise their middle; shape (joints,)."""
    inside = (arm.lower_rad < 0.0) & (arm.upper_rad > 0.0)
    with np.errstate(invalid="ignore"):
        middle = 0.5 * (arm.lower_rad + arm.upper_rad)
    ends = np.where(np.isfinite(arm.lower_rad), arm.lower_rad, arm.upper_rad)
    return np.where(inside, 0.0, np.where(np.isfinite(middle), middle, ends))


def _joints_table(setup: Setup) -> Table:
    """Driven joints in their order, with their limits; in m and N where they slide."""
    robot = setup.robot
    rows = []
    for i, name in enumerate(robot.joint_names):
        unit, force = ("m", "N") if robot.slides[i] else ("rad", "N m")
        rows.append(
            [
                f"{i + 1} {name}",
                "slides" if robot.slides[i] else "turns",
                _range(float(robot.lower_rad[i]), float(robot.upper_rad[i]), unit),
                _limit(robot.effort_limits_nm[i], force),
                _limit(robot.velocity_limits_rad_s[i], f"{unit}/s"),
            ]
        )
    return _table("Driven joints", ["Joint", "Kind", "Range", "Effort", "Speed"], rows)


def _inertia_table(setup: Setup) -> Table:
    """The inertia that sizes gains, about that with all other joints free; and with them held."""
    mass_matrix = ManipulatorModel(setup.robot).mass_matrix(setup.start_position_rad)
    rotors = drives_of(setup.robot).rotors
    rows = [
        ["governing, for gains", _values(setup.governing_inertia_kg_m2)],
        ["M_ii, others held", _values(np.diagonal(mass_matrix) + rotors)],
        ["of these, rotors", _values(rotors)],
    ]
    return _table("Inertia, kg m² (kg where joints slide)", ["Value", "Per joint"], rows)


def _other_joints_table(robot: RobotDescription) -> Table:
    """Joints that follow others or are held, and why."""
    rows = [
        [each.name, f"follows {each.leader}", f"× {each.multiplier:g} + {each.offset:g}"]
        for each in robot.followers
    ]
    rows += [[each.name, f"held at {each.position:g}", each.reason] for each in robot.held]
    return _table("Other joints", ["Joint", "State", "Detail"], rows)


def _chains_table(chains: Sequence[Chain]) -> Table:
    """Chains of a whole robot, of which one may be driven."""
    rows = [
        [each.tip, ", ".join(each.joints), f"{each.reach_m:.3g} m", f"{each.mass_kg:.3g} kg"]
        for each in chains
    ]
    title = "Chains: --chain TIP drives one and holds the rest, at zero or --hold JOINT=VALUE"
    return _table(title, ["Tip", "Joints", "Reach", "Moved mass"], rows)


def _gains_table(setup: Setup) -> Table:
    """The gains that follow from the arm's inertia, for the scenario's law."""
    rows = [[name, _values(value)] for name, value in setup.gains._asdict().items()]
    return _table(f"Gains of {setup.scenario.controller.law}", ["Gain", "Per joint"], rows)


def _drives_table(arm: RobotDescription) -> Table:
    """Motors and friction that a first scenario gives the arm, and where they come from."""
    drives = drives_of(arm)
    loop = drive_feedback(arm.drives).get("drive_feedback", {})
    is_estimated = not np.array_equal(drives.rated, arm.effort_limits_nm)
    values = {
        **({"saturation_nm": drives.rated} if is_estimated else {}),
        "rotor_inertia_kg_m2": drives.rotors,
        **actuator_values(arm.drives),
        **drives.friction,
        **{f"drive_feedback.{key}": gains for key, gains in loop.items()},
    }
    rows = [[name, _values(value)] for name, value in values.items()]
    return _table(f"Motors and friction: {drives.data}", ["Value", "Per joint"], rows)


def _table(title: str, headings: list[str], rows: Sequence[Sequence[Value]]) -> Table:
    columns = [Column(heading, is_text=True) for heading in headings]
    return Table(title, columns, [list(row) for row in rows])


def _funnel_line(setup: Setup) -> str:
    """Return the width of the funnel at start and end, in words."""
    funnel = setup.funnel
    ends = sorted({number(float(value)) for value in funnel.final_rad})
    starts = sorted({number(float(value)) for value in funnel.initial_upper_rad})
    return (
        f"funnel: opens to {', '.join(starts)} rad (m where joints slide) from rest on the"
        f" reference, closes to {', '.join(ends)} at {funnel.rate_per_s:g} per second"
    )


def _range(low: float, high: float, unit: str) -> str:
    if not np.isfinite([low, high]).any():
        return "endless"
    return f"{number(low)} … {number(high)} {unit}"


def _limit(value: float, unit: str) -> str:
    return f"{number(float(value))} {unit}" if np.isfinite(value) else "none"


def _values(value: object) -> str:
    return ", ".join(number(float(each)) for each in np.atleast_1d(np.asarray(value, dtype=float)))

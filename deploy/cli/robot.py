"""`funnel-hil robot`: what is understood of an arm."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console

from bus_schema.arrays import Vector
from bus_schema.errors import RobotDescriptionError
from bus_schema.robot_description import RobotDescription, load_robot
from bus_schema.urdf.xacro_files import INCLUDE
from deploy.reports.figures.arm.pictures import arm_picture
from deploy.reports.robot_tables import funnel_line, gains_table, joints_table, other_joints_table
from deploy.reports.terminal import print_table
from deploy.scenario.checks import check
from deploy.scenario.definition import Scenario
from deploy.scenario.explanation import Origin
from deploy.scenario.oddities import oddities
from deploy.scenario.referenced_files import find_urdf
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import ScenarioError, validated


def robot(
    file: Annotated[
        str, typer.Argument(help="A URDF or xacro file, or what a scenario's robot.urdf may be.")
    ],
    joints: Annotated[
        str | None, typer.Option("--joints", metavar="A,B,…", help="Drive these, hold all others.")
    ] = None,
    repair: Annotated[
        bool, typer.Option("--repair", help="Mend inertias that no body has, however far off.")
    ] = False,
    include: Annotated[
        list[Path] | None,
        typer.Option("--include", metavar="FOLDER", help="More folders that xacro may read."),
    ] = None,
    picture: Annotated[
        Path | None, typer.Option("--picture", metavar="FILE.png", help="Draw the arm.")
    ] = None,
) -> None:
    """Show what is understood of an arm: its joints, limits, inertias, gains, and what is odd."""
    os.environ[INCLUDE] = os.pathsep.join([*map(str, include or []), os.environ.get(INCLUDE, "")])
    chosen = None if joints is None else [name.strip() for name in joints.split(",")]
    try:
        path = find_urdf(file, Path.cwd())
        arm = load_robot(path, chosen, repair=repair)
    except RobotDescriptionError as error:
        text = str(error)
        raise ScenarioError(text if text.startswith("/") else f"{file}: {text}") from error
    setup = at_rest(arm, chosen, repair=repair)
    console = Console()
    console.print(f"{arm.path}: {arm.joints} driven joints, tip {arm.tip_link}", markup=False)
    print_table(console, joints_table(setup))
    if arm.followers or arm.held:
        print_table(console, other_joints_table(setup))
    print_table(console, gains_table(setup))
    console.print(funnel_line(setup), markup=False, highlight=False)
    for said in oddities(setup):
        console.print(f"warning: {said}", style="yellow", markup=False, highlight=False)
    if picture is not None:
        picture.write_bytes(arm_picture(arm, setup.start_position_rad))
        console.print(f"picture: {picture}", soft_wrap=True)


def at_rest(
    arm: RobotDescription,
    joints: list[str] | None = None,
    *,
    repair: bool = False,
    duration_s: float = 1.0,
) -> Setup:
    """A scenario in which the arm holds still, checked as any other.

    Args:
        arm: the arm.
        joints: what `load_robot` was given to drive.
        repair: what it was given to mend.
        duration_s: of a run.

    Raises:
        ScenarioError: no scenario could run this arm.
    """
    origin = Origin(arm.path)
    rest = {"time_s": 0.0, "position_rad": _middle(arm).tolist()}
    values = {
        "name": "robot",
        "duration_s": duration_s,
        "robot": {"urdf": str(arm.path), "joints": joints, "repair": repair},
        "reference": {"kind": "minimum_jerk", "waypoints": [rest]},
        "metrics": {"from_s": 0.5 * duration_s},
    }
    return check(validated(values, Scenario, origin), origin)


def _middle(arm: RobotDescription) -> Vector:
    """Zero where the ranges have it, else their middle; shape (joints,)."""
    inside = (arm.lower_rad < 0.0) & (arm.upper_rad > 0.0)
    with np.errstate(invalid="ignore"):
        middle = 0.5 * (arm.lower_rad + arm.upper_rad)
    ends = np.where(np.isfinite(arm.lower_rad), arm.lower_rad, arm.upper_rad)
    return np.where(inside, 0.0, np.where(np.isfinite(middle), middle, ends))

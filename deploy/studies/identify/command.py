"""The command `identify`: from a robot's own log to its plant."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from bus_schema.arrays import Vector
from bus_schema.errors import InputError
from bus_schema.robot_description import RobotDescription
from bus_schema.time_units import Unit
from deploy.cli.parts.options import IncludeOption, JointsOption, MassOption, taking
from deploy.measure.identify.design import design, write_design
from deploy.measure.identify.identification import Wishes
from deploy.measure.identify.identification import identify as identify_arm
from deploy.measure.identify.identified import Identified
from deploy.measure.identify.results import RANGES, SCENARIO, check_is_free, write_results
from deploy.reports.terminal import print_table
from deploy.run.console import Console
from deploy.run.new_folder import new_folder
from deploy.scenario.referenced_files import named_robot
from deploy.studies.identify.page import error_table, joint_table, write_identify_report

_DESIGN_S = 30.0


@dataclass(kw_only=True)
class IdentifyOptions:
    """The options of `identify`."""

    logs: Annotated[
        list[Path] | None,
        typer.Argument(metavar="LOG…", help="CSV, Parquet, MCAP or rosbag2 files of one robot."),
    ] = None
    robot: Annotated[
        str | None, typer.Option(help="The arm's file, or the name of a shipped robot.")
    ] = None
    joints: JointsOption = None
    include: IncludeOption = None
    mass: MassOption = None
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for the results.")] = None
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace results in that folder.")
    ] = False
    test: Annotated[
        list[Path] | None,
        typer.Option(metavar="LOG", help="Log to test on; repeatable.", show_default=False),
    ] = None
    held_out: Annotated[
        float, typer.Option(help="Without --test: share at the end of each log to test on.")
    ] = 1.0 / 3.0
    position: Annotated[
        str | None,
        typer.Option(
            help="Columns of positions: a,b,… or a pattern with {n} or {joint}; topic of a bag."
        ),
    ] = None
    velocity: Annotated[str | None, typer.Option(help="Columns of velocities.")] = None
    torque: Annotated[str | None, typer.Option(help="Columns of torques.")] = None
    current: Annotated[str | None, typer.Option(help="Columns of motor currents.")] = None
    command: Annotated[
        str | None, typer.Option(help="Columns of commanded positions, for the dead time.")
    ] = None
    time: Annotated[str | None, typer.Option(help="Column of times.")] = None
    unit: Annotated[
        Unit | None,
        typer.Option(
            help=r"Unit of the times, if the name of their column does not say it.  \[default: s]"
        ),
    ] = None
    degrees: Annotated[
        bool, typer.Option("--degrees", help="Positions and velocities are in degrees.")
    ] = False
    link_side: Annotated[
        bool,
        typer.Option(
            "--link-side", help="Torques are measured beyond the gears: no rotor acts on them."
        ),
    ] = False
    current_constants: Annotated[
        str | None,
        typer.Option(metavar="A,B,…", help="N m/A of each joint; by default from its weight."),
    ] = None
    payload: Annotated[
        Path | None, typer.Option(metavar="LOG", help="Log of the same arm with a payload.")
    ] = None
    payload_kg: Annotated[
        float | None, typer.Option(metavar="KG", help="Its mass, to check the current constants.")
    ] = None
    design_file: Annotated[
        Path | None,
        typer.Option(
            "--design",
            metavar="FILE.csv",
            help="Write a trajectory that shows all parameters; FILE.yaml is a JointTrajectory.",
        ),
    ] = None
    duration_s: Annotated[
        float, typer.Option("--duration", metavar="S", help="Duration of that trajectory.")
    ] = _DESIGN_S

    def require_effect(self) -> None:
        """Refuse options that would change nothing.

        Raises:
            InputError: there is one.
        """
        has_payload_alone = self.payload_kg is not None and self.payload is None
        idle = {
            "--held-out": self.held_out != Wishes.held_out and self.test and "without --test",
            "--payload-kg": has_payload_alone and "with --payload",
            "--duration": self.duration_s != _DESIGN_S and "with --design",
        }
        for name, allowed in idle.items():
            if allowed:
                raise InputError(f"identify: {name} has no effect here: must be given {allowed}")
        if not 0.05 <= self.held_out <= 0.9:
            raise InputError(f"--held-out {self.held_out:g}: must be between 0.05 and 0.9")

    def arm(self) -> RobotDescription:
        """Return the robot; raises `InputError` without one that can be used."""
        if self.robot is None:
            raise InputError("identify: --robot must name the arm's file, or a shipped robot")
        joints = None if self.joints is None else [e.strip() for e in self.joints.split(",")]
        return named_robot(self.robot, joints, self.include or (), self.mass)

    def wishes(self, arm: RobotDescription) -> Wishes:
        """Return the options of the identification."""
        kinds = ("position", "velocity", "torque", "current", "command", "time")
        given = self.current_constants
        return Wishes(
            {kind: getattr(self, kind) for kind in kinds}, self.unit, self.degrees, self.link_side,
            self.held_out, None if given is None else _numbers(given, arm), self.payload_kg,
        )  # fmt: skip


@taking(IdentifyOptions)
def identify(options: IdentifyOptions) -> None:
    """Identify an arm from its own log: masses, friction, rotors, delay, with intervals.

    DIR gets a URDF, a scenario, ranges for `margin --uncertainty`, a summary and a report. With
    --design, the command writes a trajectory that would show all of it, instead.
    """
    arm, logs = options.arm(), options.logs
    if options.design_file is not None:
        if logs:
            raise InputError(f"--design {options.design_file}: must be given without LOG files")
        _design(arm, options.design_file, options.duration_s)
        return
    if not logs:
        raise InputError("identify: give one or more LOG files")
    options.require_effect()
    found = identify_arm(logs, options.test or [], options.payload, arm, options.wishes(arm))
    folder = new_folder(f"identify-{arm.path.stem}", options.out, overwrite=options.overwrite)
    check_is_free(folder)
    summary = write_results(found, folder)
    write_identify_report(found, summary, folder / "report.html")
    _show(found, folder)


def _design(arm: RobotDescription, file: Path, duration_s: float) -> None:
    if file.suffix != ".csv":
        raise InputError(f"--design {file}: must end in .csv; the JointTrajectory ends in .yaml")
    for each in (file, file.with_suffix(".yaml")):
        if each.exists():
            raise InputError(f"--design {file}: {each} exists; name another file")
    if not file.absolute().parent.is_dir():
        raise InputError(f"--design {file}: there is no folder {file.absolute().parent}")
    found = design(arm, duration_s)
    beside = write_design(found, arm, file)
    print(f"condition number of the regressor: {found.condition:.3g}")
    for j, name in enumerate(arm.joint_names):
        low, high = found.motion[0, :, j].min(), found.motion[0, :, j].max()
        fastest = np.abs(found.motion[1, :, j]).max()
        print(f"{name}: {low:.3g} … {high:.3g} rad, at most {fastest:.3g} rad/s")
    print("check it for collisions of the arm with itself and with what is around it")
    print(f"trajectory: {file}\nJointTrajectory: {beside}")


def _numbers(text: str, arm: RobotDescription) -> Vector:
    try:
        values = np.array([float(each) for each in text.split(",")])
    except ValueError:
        values = np.zeros(0)
    if len(values) != arm.joints or not (values > 0.0).all():
        allowed = f"must be {arm.joints} positive numbers, one per joint, in N m/A"
        raise InputError(f"--current-constants {text[:100]}: {allowed}")
    return values


def _show(found: Identified, folder: Path) -> None:
    """Print the errors, the joints, what was not seen, and the next commands."""
    console = Console()
    for table in (error_table(found), joint_table(found)):
        print_table(console, table)
    if found.payload is not None:
        kg, half = found.payload.kg
        print(f"payload: {kg:.3f} ± {half:.3f} kg")
    for warning in found.warnings:
        print(f"warning: {warning}")
    for note in found.notes:
        print(f"note: {note}")
    print(f"not seen in these logs: {'; '.join(found.not_seen)}")
    scenario, ranges = (shlex.quote(str(folder / name)) for name in (SCENARIO, RANGES))
    print(f"results: {folder}\nfunnel-hil simulate {scenario} runs it")
    print(
        f"funnel-hil margin {scenario} --uncertainty {ranges} --plants 40 --values 4,8,16,32"
        " finds how much delay this robot tolerates"
    )

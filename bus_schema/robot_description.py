"""An arm as described by a URDF file, and a URDF that every simulator reads in the same way."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.errors import RobotDescriptionError
from bus_schema.urdf.chains import chain_warnings
from bus_schema.urdf.checks import MOVING_TYPES, check_urdf, finite_number
from bus_schema.urdf.drive_values import DriveValues, drive_values
from bus_schema.urdf.end_effectors import OF_GRIPPERS
from bus_schema.urdf.gyration import mend_gyration
from bus_schema.urdf.held_pose import fix_held
from bus_schema.urdf.implausible import mass_warnings
from bus_schema.urdf.inertia import judge_inertias
from bus_schema.urdf.inertia_estimate import estimate_inertias, estimated_links
from bus_schema.urdf.joints import Follower, HeldJoint, drop_empty_ranges, joint_roles
from bus_schema.urdf.link_tree import LinkTree
from bus_schema.urdf.resolved import (
    attach_mount,
    attach_payload,
    drop_shapes,
    long_axes,
    missing_meshes,
    name_files,
    name_meshes,
    resolve_inertias,
    resolve_joints,
    write_plainly,
)
from bus_schema.urdf.text import drop_frames, parsed
from bus_schema.urdf.xacro_files import expanded, is_xacro
from bus_schema.user_files import read_text

Shapes = Literal["named", "drawable", "none"]

_Wanted = tuple[tuple[str, ...] | None, bool, tuple[tuple[str, float], ...]]
"""Joints to drive, whether to hold grippers, and positions of joints that are held."""


@dataclass(frozen=True)
class RobotDescription:
    """An arm as its URDF describes it; joints in the order of the file.

    Prismatic joints use m, m/s and N where revolute joints use rad, rad/s and N m.

    Attributes:
        path: the URDF file.
        text: its content.
        joint_names: names of the driven joints; each other joint follows one of them or is fixed.
        effort_limits_nm: largest torque of each joint (inf where the URDF has none).
        velocity_limits_rad_s: largest speed of each joint (inf where the URDF has none).
        lower_rad: lower end of each joint's range (-inf for continuous joints).
        upper_rad: upper end of each joint's range (inf for continuous joints).
        tip_link: the last link behind most driven joints, which carries the payload.
        slides: whether each joint is prismatic.
        drives: motor and gear values of the file.
        followers: mimic joints, each moved by a driven joint.
        held: movable joints that are held fixed, and why.
        warnings: accepted but suspicious contents of the file, a sentence each.
        base_rpy_rad: roll, pitch and yaw of the mounted base; None for an upright one.
        reading: how the file is read, as in the section ``robot`` of a scenario.
        estimated: what of its inertias is ESTIMATED; an empty text for nothing.
    """

    path: Path
    text: str
    joint_names: tuple[str, ...]
    effort_limits_nm: Vector
    velocity_limits_rad_s: Vector
    lower_rad: Vector
    upper_rad: Vector
    tip_link: str
    slides: tuple[bool, ...]
    drives: DriveValues
    followers: tuple[Follower, ...] = ()
    held: tuple[HeldJoint, ...] = ()
    warnings: tuple[str, ...] = field(default=(), compare=False)
    base_rpy_rad: tuple[float, float, float] | None = None
    reading: Mapping[str, Any] = field(default_factory=dict, compare=False)
    estimated: str = ""

    @property
    def joints(self) -> int:
        return len(self.joint_names)

    def joint_positions(self, driven: Vector) -> dict[str, float]:
        """Return the positions of all joints that move, by name, for those of the driven ones."""
        positions = dict(zip(self.joint_names, driven.tolist(), strict=True))
        for each in self.followers:
            positions[each.name] = each.multiplier * positions[each.leader] + each.offset
        return positions

    def portable_urdf(self) -> str:
        """Return the URDF for use in another folder: mesh files by absolute path."""
        root = ET.fromstring(self.text)
        if root.find(".//mesh") is None:
            return self.text
        name_meshes(root, self.path.parent)
        return ET.tostring(root, encoding="unicode")

    def viewer_urdf(self) -> str:
        """Return the URDF for 3-D viewers: existing mesh files as ``file://`` and absolute path."""
        root = ET.fromstring(self.resolved_urdf(shapes="drawable"))
        name_files(root)
        return ET.tostring(root, encoding="unicode")

    def resolved_urdf(self, payload_kg: float = 0.0, shapes: Shapes = "named") -> str:
        """Return the mounted arm, with every joint revolute, prismatic or fixed, with unit axes.

        Args:
            payload_kg: point mass fixed to the origin of the tip link.
            shapes: visual and collision shapes to keep: all, with mesh files ``named`` by absolute
                path; the ``drawable`` ones; or ``none``, as for physics.
        """
        moving = (frozenset(self.joint_names), frozenset(each.name for each in self.followers))
        payload = (self.tip_link, payload_kg)
        if shapes == "none":  # no mesh on the disk counts, and every load of an arm asks for it
            return _of_bodies(self.text, *moving, self.base_rpy_rad, payload)
        return _resolved(self.text, *moving, self.base_rpy_rad, payload, self.path.parent, shapes)


def _resolved(
    text: str,
    driven: frozenset[str],
    followers: frozenset[str],
    base_rpy_rad: tuple[float, float, float] | None,
    payload: tuple[str, float],
    folder: Path,
    shapes: Shapes,
) -> str:
    """Return `RobotDescription.resolved_urdf`; a payload is its link and its mass."""
    root = ET.fromstring(text)
    write_plainly(root)
    resolve_joints(root, driven, followers)
    if base_rpy_rad is not None:
        attach_mount(root, base_rpy_rad)
    resolve_inertias(root)
    if shapes == "none":
        drop_shapes(root, but_drawable=False)
    name_meshes(root, folder)
    if shapes == "drawable":
        drop_shapes(root, but_drawable=True)
    if payload[1] > 0.0:
        attach_payload(root, *payload)
    ET.indent(root)  # Bullet splits lines of more than 8192 characters
    return ET.tostring(root, encoding="unicode")


@lru_cache(maxsize=32)
def _of_bodies(
    text: str,
    driven: frozenset[str],
    followers: frozenset[str],
    base_rpy_rad: tuple[float, float, float] | None,
    payload: tuple[str, float],
) -> str:
    return _resolved(text, driven, followers, base_rpy_rad, payload, Path(), "none")


def load_robot(
    path: Path,
    driven: Sequence[str] | None = None,
    *,
    repair: bool = False,
    arguments: Mapping[str, str] = MappingProxyType({}),
    include: Sequence[Path] = (),
    mass_kg: float | None = None,
    hold: Mapping[str, float] = MappingProxyType({}),
    hold_grippers: bool = False,
) -> RobotDescription:
    """Read a URDF file, or an MJCF file as a URDF.

    Args:
        path: the file.
        driven: joints to drive; None for all with a motor, see `joint_roles`.
        repair: replace all impossible inertias, even those far off.
        arguments: values of the arguments of a xacro file, by name.
        include: folders with files that it refers to, besides its own and ROS packages.
        mass_kg: mass of the whole arm, where its file gives no inertias; None for an estimate.
        hold: positions of joints that are held, by name, rad or m; others are held at zero.
        hold_grippers: hold the joints of grippers, wheels and heads, if `driven` is None.

    Raises:
        RobotDescriptionError: it cannot be read, or has no joint to drive.
    """
    text, root = _parse(path, arguments, include)
    left_out: list[str] = []
    try:
        if root.tag == "mujoco":
            from bus_schema.urdf.mjcf.from_mjcf import (
                urdf_from_mjcf,  # which imports MuJoCo: 0.15 s
            )

            root, left_out = urdf_from_mjcf(root, path, driven, hold, include)
            text = ET.tostring(root, encoding="unicode")
        names = None if driven is None else tuple(driven)
        wanted = (names, hold_grippers, tuple(hold.items()))
        if root.find(".//mesh") is None:  # studies read the same arm hundreds of times
            known = _of_text(path, text, *wanted, repair=repair, mass_kg=mass_kg)
            robot = deepcopy(known)  # a user's law may write into the arrays of a run
        else:
            robot = _as_read(
                path, root, wanted, text, repair=repair, include=include, mass_kg=mass_kg
            )
        is_chosen = bool(driven or hold) or any(each.reason in OF_GRIPPERS for each in robot.held)
        reading = {
            "joints": list(robot.joint_names) if is_chosen else [],
            "repair": repair,
            "xacro": dict(arguments),
            "include": [str(each) for each in include],
            "mass_kg": mass_kg,
            "hold": dict(hold),
        }
        reading = {key: value for key, value in reading.items() if value}
        return replace(robot, warnings=(*left_out, *robot.warnings), reading=reading)
    except RobotDescriptionError as error:
        raise type(error)(f"{path}: {error}") from error


@lru_cache(maxsize=32)
def _of_text(
    path: Path,
    text: str,
    driven: tuple[str, ...] | None,
    hold_grippers: bool,
    hold: tuple[tuple[str, float], ...],
    *,
    repair: bool,
    mass_kg: float | None,
) -> RobotDescription:
    """Return an arm without meshes, which follows from its text alone."""
    wanted, root = (driven, hold_grippers, hold), ET.fromstring(text)
    return _as_read(path, root, wanted, text, repair=repair, include=(), mass_kg=mass_kg)


def _as_read(
    path: Path,
    root: ET.Element,
    wanted: _Wanted,
    text: str,
    *,
    repair: bool,
    include: Sequence[Path],
    mass_kg: float | None,
) -> RobotDescription:
    if not any(joint.get("type") in MOVING_TYPES for joint in root.findall("joint")):
        raise RobotDescriptionError("has no revolute, continuous or prismatic joint")
    too_many = drop_frames(root)
    check_urdf(root)
    mended = [*too_many, *drop_empty_ranges(root)]
    text = ET.tostring(root, encoding="unicode") if mended else text
    driven, hold_grippers, hold = wanted
    roles = joint_roles(root, driven, hold_grippers, dict(hold))
    moving = {*roles.driven, *(each.name for each in roles.followers)}
    is_posed = fix_held(root, roles.held)
    estimate_inertias(root, path.parent, moving, include, mass_kg)
    warnings = mend_gyration(root, path.parent, moving, include, repair=repair)
    if is_posed or estimated_links(root):
        text = ET.tostring(root, encoding="unicode")
    warnings += judge_inertias(root, moving, repair=repair) + _warnings_of(path, root, moving)
    warnings += [*mended, *mass_warnings(root, moving)]
    if driven is None:
        warnings += chain_warnings(root, roles.driven)
    joints = [joint for joint in root.findall("joint") if joint.get("name") in roles.driven]
    lower, upper = _limits(joints, "lower", -math.inf), _limits(joints, "upper", math.inf)
    _check_ranges(roles.driven, lower, upper)
    return RobotDescription(
        path=path,
        text=text,
        joint_names=roles.driven,
        effort_limits_nm=_limits(joints, "effort", math.inf),
        velocity_limits_rad_s=_limits(joints, "velocity", math.inf),
        lower_rad=lower,
        upper_rad=upper,
        tip_link=_tip_link(root, roles.driven),
        estimated=estimated_links(root),
        slides=tuple(joint.get("type") == "prismatic" for joint in joints),
        drives=drive_values(root, roles.driven),
        followers=roles.followers,
        held=roles.held,
        warnings=tuple(warnings),
    )


def _check_ranges(names: Sequence[str], lower: Vector, upper: Vector) -> None:
    for name, low, high in zip(names, lower, upper, strict=True):
        if low >= high:
            raise RobotDescriptionError(
                f"joint {name} has lower={low:g} and upper={high:g}: lower must be less than"
                " upper, or the joint must be continuous, fixed, or not in robot.joints"
            )


def _warnings_of(path: Path, root: ET.Element, moving: set[str]) -> list[str]:
    """Return warnings about accepted but suspicious contents of a file."""
    sentences = [
        f"the axis of joint {name} is not a unit vector: only its direction is used"
        for name in long_axes(root)
        if name in moving
    ]
    if missing := missing_meshes(root, path.parent):
        sentences.append(
            f"{len(missing)} mesh file(s) cannot be found or drawn, such as {missing[0]}: they are"
            " missing in pictures; the physics does not need them"
        )
    return sentences


def _parse(
    path: Path, arguments: Mapping[str, str], include: Sequence[Path]
) -> tuple[str, ET.Element]:
    if arguments and not is_xacro(path):
        shown = " ".join(f"{name}:={value}" for name, value in arguments.items())
        raise RobotDescriptionError(f"{path}: {shown}: only a .xacro file has arguments")
    try:
        is_there = is_xacro(path) and path.is_file()
        text = expanded(path, arguments, include) if is_there else read_text(path)
        text, root = parsed(text)
        if include and name_meshes(root, path.parent, include):
            text = ET.tostring(root, encoding="unicode")
    except FileNotFoundError as error:
        raise RobotDescriptionError(f"{path} does not exist") from error
    except (OSError, ET.ParseError) as error:
        raise RobotDescriptionError(f"{path} cannot be read as URDF: {error}") from error
    if root.tag not in ("robot", "mujoco"):
        raise RobotDescriptionError(
            f"{path} is neither URDF nor MJCF: its root element is <{root.tag}>"
        )
    return text, root


def _limits(joints: list[ET.Element], attribute: str, missing: float) -> Vector:
    is_range = attribute in ("lower", "upper")
    values = []
    for joint in joints:
        limit = joint.find("limit")
        text = None if limit is None else limit.get(attribute)
        if text is None or (is_range and joint.get("type") == "continuous"):
            values.append(missing)
            continue
        value = finite_number(f"joint {joint.get('name')}", attribute, text)
        # A zero effort or velocity limit is how many exporters write "unknown".
        values.append(missing if value <= 0.0 and not is_range else value)
    return np.array(values)


def _tip_link(root: ET.Element, driven: Sequence[str]) -> str:
    """Return the last link behind most of the driven joints."""
    tree = LinkTree(root)

    def depth(link: str) -> tuple[int, int]:
        names = [joint.get("name") for joint in tree.above(link)]
        return sum(name in driven for name in names), len(names)

    return max(tree.joints, key=depth)

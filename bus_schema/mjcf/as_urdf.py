"""MJCF (MuJoCo's format) as URDF: bodies, joints that turn or slide, ranges and largest torques.

What has no place there is left out and told (springs, damping), or refused (loops, ball joints).
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from itertools import count

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.errors import RobotDescriptionError
from bus_schema.mjcf.bodies import Inertial, Solid, inertial_of, solid_of
from bus_schema.mjcf.efforts import Efforts
from bus_schema.mjcf.settings import (
    DEEPEST,
    Attributes,
    Defaults,
    compiler_of,
    numbers,
    turned,
    unit,
    vector,
)
from bus_schema.mjcf.settings import orientation as orientation_of
from bus_schema.urdf.checks import finite_number, shortened

_KINDS = {"hinge": "revolute", "slide": "prismatic"}
_FORBIDDEN = ("tendon", "equality", "deformable", "extension")
_MACROS = ("include", "composite", "flexcomp", "replicate", "attach", "frame")
_LEFT_OUT = ("armature", "damping", "frictionloss", "stiffness")


def is_mjcf(root: ET.Element) -> bool:
    """Whether a file holds MuJoCo's format."""
    return root.tag == "mujoco"


def as_urdf(root: ET.Element) -> tuple[ET.Element, list[str]]:
    """The same arm as a URDF, and what was left out of it, a sentence each.

    Args:
        root: the MJCF file.

    Raises:
        RobotDescriptionError: it cannot be read, or has what no tree of such joints has.
    """
    for name in _FORBIDDEN:
        for found in (each for part in root.findall(name) for each in part):
            raise RobotDescriptionError(
                f"{name} {found.get('name', found.tag)}: must be left out, as only a tree of bodies"
                " can be emulated"
            )
    for name in _MACROS:
        if root.find(f".//{name}") is not None:
            raise RobotDescriptionError(f"<{name}> is not understood: write out what it stands for")
    worldbody = root.find("worldbody")
    if worldbody is None:
        raise RobotDescriptionError("has no worldbody")
    return _Converter(root).convert(worldbody)


class _Converter:
    """Writes links and joints, body by body."""

    def __init__(self, root: ET.Element) -> None:
        self._root = root
        self._compiler = compiler_of(root)
        self._defaults = Defaults(root)
        self._efforts = Efforts(root, self._defaults, self._compiler)
        self._urdf = ET.Element("robot", name=root.get("model", "mjcf"))
        self._numbers = count(1)
        self._left_out: dict[str, None] = {}
        self._passive: list[str] = []
        self._floated: list[str] = []

    def convert(self, worldbody: ET.Element) -> tuple[ET.Element, list[str]]:
        ET.SubElement(self._urdf, "link", name="world")
        free = [body for body in worldbody.findall("body") if _is_free(body)]
        fixed = [body for body in worldbody.findall("body") if body not in free]
        if free and not fixed:
            raise RobotDescriptionError(
                f"{_shown(free[0])} has a free joint: an arm must be fixed to the world"
            )
        for body in fixed:
            self._body(body, "world", np.zeros(3), None, 1)
        self._efforts.require_joints(
            {joint.get("name", "") for joint in self._urdf.findall("joint")}
        )
        said = [f"MJCF: {_shown(body)} is free, and left out" for body in free]
        if self._passive:
            said.append(f"MJCF: {', '.join(self._passive)}: no actuator drives them; they are held")
        if self._left_out:
            names = ", ".join(self._left_out)
            said.append(f"MJCF: {names} of its joints are left out (plant.friction has the arm's)")
        if self._floated:
            names = ", ".join(self._floated)
            said.append(f"MJCF: gravcomp of {names} is left out: gravity pulls on all of it here")
        gravity = next((each.get("gravity") for each in self._root.iter("option")), None)
        if gravity is not None and gravity.split() != ["0", "0", "-9.81"]:
            said.append(f"MJCF: its gravity {shortened(gravity)} is left out: it is 0 0 -9.81 here")
        return self._urdf, said

    def _body(
        self, body: ET.Element, parent: str, shift: Vector, child_class: str | None, depth: int
    ) -> None:
        """Write a body and all that it carries.

        Args:
            body: its element.
            parent: the link that carries it.
            shift: where that link's origin is in the frame of its body: at its joint.
            child_class: class of what says none of its own.
            depth: how many bodies are below it.
        """
        if depth > DEEPEST:
            raise RobotDescriptionError(f"more than {DEEPEST} bodies carry one another")
        child_class = body.get("childclass", child_class)
        name = body.get("name") or f"body_{next(self._numbers)}"
        owner = f"body {name}"
        if numbers(owner, body.attrib, "gravcomp", "0").any():
            self._floated.append(owner)
        position = vector(owner, body.attrib, "pos", "0 0 0") - shift
        turn = orientation_of(owner, body.attrib, self._compiler)
        place = np.zeros(3)
        joints = list(self._joints(body, owner, child_class))
        for index, attributes in enumerate(joints, start=1):
            joint_name = attributes.get("name") or f"{name}_joint_{index}"
            at = vector(f"joint {joint_name}", attributes, "pos", "0 0 0")
            ends = (parent, name if index == len(joints) else f"{name}_{index}")
            self._joint(joint_name, attributes, ends, position + turn @ (at - place), turn)
            if index < len(joints):  # which weighs nothing, and is refused should it have to move
                ET.SubElement(self._urdf, "link", name=ends[1])
            parent, position, turn, place = ends[1], np.zeros(3), np.eye(3), at
        if not joints:
            fixed = ET.SubElement(self._urdf, "joint", name=f"{name}_fixed", type="fixed")
            _connect(fixed, parent, name, position, turn)
        self._link(name, body, place, child_class)
        for inner in body.findall("body"):
            self._body(inner, name, place, child_class, depth + 1)

    def _joints(
        self, body: ET.Element, owner: str, child_class: str | None
    ) -> Iterator[dict[str, str]]:
        """Attributes of a body's joints."""
        for joint in body.findall("joint"):
            attributes = self._defaults.of(joint, child_class)
            kind = attributes.get("type", "hinge")
            if kind not in _KINDS:
                raise RobotDescriptionError(
                    f"type={shortened(kind)!r} of joint {attributes.get('name', '')} of {owner}:"
                    f" must be {' or '.join(_KINDS)}"
                )
            yield attributes

    def _joint(
        self, name: str, attributes: Attributes, ends: tuple[str, str], at: Vector, turn: Matrix
    ) -> None:
        owner, kind = f"joint {name}", attributes.get("type", "hinge")
        axis = unit(owner, "axis", vector(owner, attributes, "axis", "0 0 1"))
        reference = finite_number(owner, "ref", attributes.get("ref", "0"))
        if reference and kind == "hinge":
            turn = turn @ turned(owner, "ref", axis, -self._compiler.angle(reference))
        elif reference:
            at = at - reference * (turn @ axis)
        joint = ET.SubElement(self._urdf, "joint", name=name, type=_KINDS[kind])
        _connect(joint, *ends, at, turn)
        if not self._efforts.drives(name):
            joint.set("type", "fixed")
            self._passive.append(name)
            return
        ET.SubElement(joint, "axis", xyz=_text(axis))
        limits = self._range(owner, attributes, is_angle=kind == "hinge")
        if limits is None and kind == "hinge":
            joint.set("type", "continuous")
        largest = self._efforts.of(name, attributes)
        limit = {"lower": limits[0], "upper": limits[1]} if limits is not None else {}
        if largest is not None:
            limit["effort"] = largest
        ET.SubElement(joint, "limit", {key: repr(float(value)) for key, value in limit.items()})
        for each in _LEFT_OUT:
            if numbers(owner, attributes, each, "0").any():
                self._left_out[each] = None

    def _range(
        self, owner: str, attributes: Attributes, *, is_angle: bool
    ) -> tuple[float, float] | None:
        limited = attributes.get("limited", "auto")
        if limited == "false" or (limited == "auto" and not self._compiler.auto_limits):
            return None
        if "range" not in attributes:
            return None
        lower, upper = vector(owner, attributes, "range", "0 0")
        if is_angle:
            lower, upper = self._compiler.angle(lower), self._compiler.angle(upper)
        return float(lower), float(upper)

    def _link(self, name: str, body: ET.Element, place: Vector, child_class: str | None) -> None:
        """Write a link, whose origin is at its joint."""
        link = ET.SubElement(self._urdf, "link", name=name)
        found = [self._defaults.of(geom, child_class) for geom in body.findall("geom")]
        geoms = [(each, solid_of(each, f"body {name}", self._compiler)) for each in found]
        inertial = inertial_of(name, body, geoms, self._compiler)
        if inertial is not None:
            _write_inertial(link, inertial, place)
        for _, solid in geoms:
            if solid is not None:
                _write_visual(link, solid, place)


def _is_free(body: ET.Element) -> bool:
    return body.find("freejoint") is not None or any(
        joint.get("type") == "free" for joint in body.findall("joint")
    )


def _shown(body: ET.Element) -> str:
    return f"body {shortened(body.get('name', ''))}".strip()


def _connect(joint: ET.Element, parent: str, child: str, at: Vector, turn: Matrix) -> None:
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    ET.SubElement(joint, "origin", xyz=_text(at), rpy=_text(_angles(turn)))


def _write_inertial(link: ET.Element, inertial: Inertial, place: Vector) -> None:
    element = ET.SubElement(link, "inertial")
    ET.SubElement(element, "origin", xyz=_text(inertial.centre - place))
    ET.SubElement(element, "mass", value=repr(inertial.mass_kg))
    names = {
        "ixx": (0, 0),
        "ixy": (0, 1),
        "ixz": (0, 2),
        "iyy": (1, 1),
        "iyz": (1, 2),
        "izz": (2, 2),
    }
    values = {name: repr(float(inertial.inertia[at])) for name, at in names.items()}
    ET.SubElement(element, "inertia", values)


def _write_visual(link: ET.Element, solid: Solid, place: Vector) -> None:
    visual = ET.SubElement(link, "visual")
    ET.SubElement(visual, "origin", xyz=_text(solid.centre - place), rpy=_text(_angles(solid.turn)))
    geometry = ET.SubElement(visual, "geometry")
    match solid.kind:
        case "box":
            ET.SubElement(geometry, "box", size=_text(2.0 * solid.size))
        case "capsule" | "cylinder":  # URDF has no capsules
            radius, half = (repr(float(each)) for each in (solid.size[0], 2.0 * solid.size[1]))
            ET.SubElement(geometry, "cylinder", radius=radius, length=half)
        case _:
            ET.SubElement(geometry, "sphere", radius=repr(float(solid.size.mean())))


def _angles(turn: Matrix) -> Vector:
    """Roll, pitch and yaw of a turn, rad."""
    across = math.hypot(turn[0, 0], turn[1, 0])
    pitch = math.atan2(-turn[2, 0], across)
    if across < 1e-9:
        return np.array([math.atan2(-turn[1, 2], turn[1, 1]), pitch, 0.0])
    return np.array([math.atan2(turn[2, 1], turn[2, 2]), pitch, math.atan2(turn[1, 0], turn[0, 0])])


def _text(values: Vector) -> str:
    return " ".join(repr(float(each)) for each in values)

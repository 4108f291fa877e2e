"""What a URDF has to be before a simulator sees it: parsers take much for granted, or crash."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections import Counter
from pathlib import Path

import numpy as np

from bus_schema.errors import RobotDescriptionError

ACTUATED_TYPES = ("revolute", "continuous")
_TYPES = (*ACTUATED_TYPES, "prismatic", "fixed", "floating", "planar")
_DEEPEST = 20
_MOST_LINKS = 200
_LONGEST_NAME = 200
_LARGEST = 1e9
_INERTIA_TOLERANCE = 1e-3
_INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def check_urdf(path: Path, root: ET.Element) -> None:
    """Check that links and joints are one tree, and that all masses and places can be.

    Raises:
        RobotDescriptionError: they are not; `path` and what is allowed are named.
    """
    try:
        _check_depth(root)
        _check_names("link", root.findall("link"))
        _check_names("joint", root.findall("joint"))
        for joint in root.findall("joint"):
            _check_joint(joint)
        for link in root.findall("link"):
            _check_inertial(link)
        _check_tree(root)
    except RobotDescriptionError as error:
        raise RobotDescriptionError(f"{path}: {error}") from error


def finite_number(owner: str, attribute: str, text: str) -> float:
    """The number in an attribute.

    Args:
        owner: what it belongs to, for messages.
        attribute: its name.
        text: what it holds.

    Raises:
        RobotDescriptionError: it is none, or one that physics cannot be computed with.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise RobotDescriptionError(f"{attribute}={_cut(text)!r} of {owner} is no finite number")
    if abs(value) > _LARGEST:
        allowed = f"must be at most {_LARGEST:g} in size"
        raise RobotDescriptionError(f"{attribute}={_cut(text)!r} of {owner} {allowed}")
    return value


def _check_depth(root: ET.Element) -> None:
    level: list[ET.Element] = [root]
    for _ in range(_DEEPEST):
        level = [child for element in level for child in element]
    if level:
        raise RobotDescriptionError(f"must not be nested deeper than {_DEEPEST} elements")


def _check_names(kind: str, elements: list[ET.Element]) -> None:
    if not 1 <= len(elements) <= _MOST_LINKS:
        allowed = f"there must be 1 to {_MOST_LINKS}"
        raise RobotDescriptionError(f"has {len(elements)} {kind}s; {allowed}")
    names = [element.get("name", "") for element in elements]
    for name, count in Counter(names).items():
        if count > 1 or not name or len(name) > _LONGEST_NAME:
            allowed = f"must be unique and not empty, of at most {_LONGEST_NAME} characters"
            raise RobotDescriptionError(f"{kind} names {allowed}: {_cut(name)!r}")


def _check_tree(root: ET.Element) -> None:
    """One link carries all others, each by one joint."""
    links = {link.get("name", "") for link in root.findall("link")}
    children: dict[str, list[str]] = {}
    carried: set[str] = set()
    for joint in root.findall("joint"):
        found = [joint.findall(kind) for kind in ("parent", "child")]
        if not all(found):
            raise RobotDescriptionError(f"{_owner(joint)} lacks parent or child")
        if any(len(ends) > 1 for ends in found):
            raise RobotDescriptionError(f"{_owner(joint)} must have one parent and one child")
        ends = [end.get("link", "") for (end,) in found]
        for kind, link in zip(("parent", "child"), ends, strict=True):
            if link not in links:
                raise RobotDescriptionError(f"{kind} of {_owner(joint)}: no link {_cut(link)!r}")
        parent, child = ends
        if child in carried:
            raise RobotDescriptionError(f"link {child!r} is the child of more than one joint")
        carried.add(child)
        children.setdefault(parent, []).append(child)
    bases = sorted(links - carried)
    if len(bases) != 1:
        shown = _cut(", ".join(bases)) or "none"
        raise RobotDescriptionError(f"one link must be the child of no joint, not {shown}")
    reached = set(bases)
    level = bases
    while level:
        level = [child for link in level for child in children.get(link, ())]
        reached.update(level)
    if reached != links:
        apart = _cut(", ".join(sorted(links - reached)))
        raise RobotDescriptionError(f"the joints of {apart} form a circle")


def _check_joint(joint: ET.Element) -> None:
    owner, kind = _owner(joint), joint.get("type", "")
    if kind not in _TYPES:
        raise RobotDescriptionError(f"type={_cut(kind)!r} of {owner}: one of {', '.join(_TYPES)}")
    _check_places(owner, joint)
    axis = joint.find("axis")
    if kind in ACTUATED_TYPES and axis is not None:
        direction = _vector(owner, "axis xyz", axis.get("xyz", "1 0 0"))
        if not 1e-3 < np.linalg.norm(direction) < 1e3:
            raise RobotDescriptionError(f"axis xyz={axis.get('xyz')!r} of {owner} is no direction")
    for limit in joint.findall("limit"):
        for name in ("lower", "upper", "effort", "velocity"):
            if name in limit.attrib:
                finite_number(owner, name, limit.attrib[name])
    if kind in ACTUATED_TYPES and joint.find("mimic") is not None:
        raise RobotDescriptionError(f"{owner} mimics another one, which no joint with a motor may")


def _check_inertial(link: ET.Element) -> None:
    """Refuse inertias that no body has: pybullet would silently set them to zero."""
    owner, inertial = _owner(link), link.find("inertial")
    if inertial is None:
        return
    _check_places(owner, inertial)
    mass, inertia = _the_one(inertial, "mass", owner), _the_one(inertial, "inertia", owner)
    mass_kg = finite_number(owner, "mass", mass.get("value", ""))
    if mass_kg < 0.0:
        raise RobotDescriptionError(f"mass={mass_kg:g} of {owner} must not be negative")
    xx, xy, xz, yy, yz, zz = (
        finite_number(owner, name, inertia.get(name, "0")) for name in _INERTIA
    )
    principal = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    slack = _INERTIA_TOLERANCE * max(abs(principal[-1]), 1e-12)
    if principal[0] < -slack or principal[-1] > principal[0] + principal[1] + slack:
        raise RobotDescriptionError(
            f"{owner} has principal moments of inertia"
            f" {principal.tolist()}; none may be negative or exceed the sum of the others"
        )


def _check_places(owner: str, element: ET.Element) -> None:
    for origin in element.findall("origin"):
        for name in ("xyz", "rpy"):
            if name in origin.attrib:
                _vector(owner, f"origin {name}", origin.attrib[name])


def _vector(owner: str, name: str, text: str) -> list[float]:
    parts = text.split()
    if len(parts) != 3:
        raise RobotDescriptionError(f"{name}={_cut(text)!r} of {owner} must be three numbers")
    return [finite_number(owner, name, part) for part in parts]


def _the_one(element: ET.Element, tag: str, owner: str) -> ET.Element:
    found = element.findall(tag)
    if len(found) != 1:
        raise RobotDescriptionError(f"{owner} must have one {tag}")
    return found[0]


def _owner(element: ET.Element) -> str:
    return f"{element.tag} {_cut(element.get('name', ''))}"


def _cut(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "..."

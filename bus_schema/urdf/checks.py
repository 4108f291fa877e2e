"""Checks of a URDF before a simulator loads it: their parsers check little, or crash."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections import Counter

from bus_schema.errors import RobotDescriptionError
from bus_schema.foreign_text import quoted, shortened

MOVING_TYPES = ("revolute", "continuous", "prismatic")
INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_TYPES = (*MOVING_TYPES, "fixed", "floating", "planar")
_DEEPEST = 20
MOST_LINKS = 127  # Bullet takes 128, and the payload is one of them
_LONGEST_NAME = 200
_LARGEST = 1e9
_UNEXPANDED = re.compile(r"\$[{(][^})]*[})]")


def check_urdf(root: ET.Element) -> None:
    """Check that links and joints form one tree, and that masses and poses are possible.

    Raises:
        RobotDescriptionError: they are not; the message names the element and what is allowed.
    """
    check_depth(root)
    _check_texts(root)
    _check_names("link", root.findall("link"))
    _check_names("joint", root.findall("joint"))
    for joint in root.findall("joint"):
        _check_joint(joint)
    for link in root.findall("link"):
        _check_inertial(link)
    _check_tree(root)


def finite_number(owner: str, attribute: str, text: str) -> float:
    """Return the number in an attribute.

    Args:
        owner: what it belongs to, for messages.
        attribute: its name.
        text: its value.

    Raises:
        RobotDescriptionError: it is no number, or one that physics cannot use.
    """
    try:
        value = math.nan if "_" in text else float(text)  # Python alone reads 1_0 as 10
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise RobotDescriptionError(f"{attribute}={quoted(text)} of {owner} is not a finite number")
    if abs(value) > _LARGEST:
        allowed = f"must be at most {_LARGEST:g} in size"
        raise RobotDescriptionError(f"{attribute}={quoted(text)} of {owner} {allowed}")
    return value


def check_depth(root: ET.Element, deepest: int = _DEEPEST) -> None:
    """Check that elements are nested no deeper than this.

    Raises:
        RobotDescriptionError: they are.
    """
    level: list[ET.Element] = [root]
    for _ in range(deepest):
        level = [child for element in level for child in element]
    if level:
        raise RobotDescriptionError(f"must not be nested deeper than {deepest} elements")


def _check_texts(root: ET.Element) -> None:
    """Refuse unexpanded xacro, and texts that Bullet takes for a format.

    Bullet prints names as formats: ``%s`` in a name ends the process.
    """
    for element in root.iter():
        named = element.get("name", "")
        where = f"<{element.tag}" + (f" name={quoted(named)}>" if named else ">")
        for name, text in element.attrib.items():
            if (found := _UNEXPANDED.search(text)) is not None:
                raise RobotDescriptionError(
                    f"{name} of {where} holds {quoted(found.group())}, which xacro has not"
                    " expanded: name the .xacro file itself, or run xacro on it first"
                )
        if "%" in named:
            raise RobotDescriptionError(f"name={quoted(named)} of <{element.tag}> must have no %")


def _check_names(kind: str, elements: list[ET.Element]) -> None:
    if not 1 <= len(elements) <= MOST_LINKS:
        allowed = f"there must be 1 to {MOST_LINKS}"
        raise RobotDescriptionError(f"has {len(elements)} {kind}s; {allowed}")
    names = [element.get("name", "") for element in elements]
    for name, count in Counter(names).items():
        if count > 1 or not name or len(name) > _LONGEST_NAME:
            allowed = f"must be unique and not empty, of at most {_LONGEST_NAME} characters"
            raise RobotDescriptionError(f"{kind} names {allowed}: {quoted(name)}")


def _check_tree(root: ET.Element) -> None:
    """Check that one link carries all others, each by one joint."""
    links = {link.get("name", "") for link in root.findall("link")}
    carriers: dict[str, str] = {}
    for joint in root.findall("joint"):
        ends = joint_ends(joint)
        for kind, link in zip(("parent", "child"), ends, strict=True):
            if link not in links:
                raise RobotDescriptionError(f"{kind} of {_owner(joint)}: no link {quoted(link)}")
        parent, child = ends
        if parent == child:
            allowed = "parent and child must be two links"
            raise RobotDescriptionError(
                f"{_owner(joint)} joins link {quoted(child)} to itself; {allowed}"
            )
        if child in carriers:
            raise RobotDescriptionError(f"link {child!r} is the child of more than one joint")
        carriers[child] = parent
    bases = sorted(links - carriers.keys())
    if len(bases) != 1:
        named = shortened(", ".join(bases)) or "none"
        raise RobotDescriptionError(f"one link must be the child of no joint, not {named}")
    if apart := links - _reached(bases[0], carriers):
        named = shortened(", ".join(sorted(apart)))
        raise RobotDescriptionError(f"the joints of {named} form a circle")


def _reached(base: str, carriers: dict[str, str]) -> set[str]:
    """Return the base and all links that it carries."""
    carried: dict[str, list[str]] = {}
    for child, parent in carriers.items():
        carried.setdefault(parent, []).append(child)
    reached, ends = {base}, [base]
    while ends:
        following = carried.get(ends.pop(), [])
        reached.update(following)
        ends += following
    return reached


def _check_joint(joint: ET.Element) -> None:
    owner, kind = _owner(joint), joint.get("type", "")
    if kind not in _TYPES:
        raise RobotDescriptionError(f"type={quoted(kind)} of {owner}: one of {', '.join(_TYPES)}")
    _check_places(owner, joint)
    axis = joint.find("axis")
    if kind in MOVING_TYPES and axis is not None:
        direction = _vector(owner, "axis xyz", axis.get("xyz", "1 0 0"))
        if not 1e-3 < math.hypot(*direction) < 1e3:
            given = f"axis xyz={quoted(axis.get('xyz', ''))} of {owner} is no direction"
            raise RobotDescriptionError(f"{given}; must be 0.001 to 1000 long, such as 0 0 1")
    for limit in joint.findall("limit"):
        for name in ("lower", "upper", "effort", "velocity"):
            if name in limit.attrib:
                finite_number(owner, name, limit.attrib[name])
    for dynamics in joint.findall("dynamics"):
        for name in ("damping", "friction"):
            _check_resistance(owner, name, dynamics.get(name, ""))


def _check_resistance(owner: str, name: str, text: str) -> None:
    """Check friction; a word instead of a number means that it is unknown."""
    try:
        float(text)
    except ValueError:
        return
    if finite_number(owner, name, text) < 0.0:
        raise RobotDescriptionError(
            f"{name}={quoted(text)} of {owner} must not be negative: it would drive the joint"
        )


def _check_inertial(link: ET.Element) -> None:
    """Check that an inertial element has a mass, an inertia, and a pose."""
    owner, inertial = _owner(link), link.find("inertial")
    if inertial is None:
        return
    _check_places(owner, inertial)
    if mass_of(link) < 0.0:
        raise RobotDescriptionError(f"mass={mass_of(link):g} of {owner} must not be negative")
    inertia_of(link)


def joint_ends(joint: ET.Element) -> tuple[str, str]:
    """Return the names of the parent link and of the child link.

    Raises:
        RobotDescriptionError: one is missing, or named more than once.
    """
    found = [joint.findall(kind) for kind in ("parent", "child")]
    if not all(found):
        raise RobotDescriptionError(f"{_owner(joint)} lacks parent or child")
    if any(len(ends) > 1 for ends in found):
        raise RobotDescriptionError(f"{_owner(joint)} must have one parent and one child")
    parent, child = (end.get("link", "") for (end,) in found)
    return parent, child


def mass_of(link: ET.Element) -> float:
    """Return the mass of a link, kg; 0 without an inertial element."""
    inertial = link.find("inertial")
    if inertial is None:
        return 0.0
    mass = _the_one(inertial, "mass", _owner(link))
    return finite_number(_owner(link), "mass", mass.get("value", ""))


def inertia_of(link: ET.Element) -> list[float]:
    """Return a link's moments of inertia, kg m², in the order of `INERTIA`; 0 without them."""
    inertial = link.find("inertial")
    if inertial is None:
        return [0.0] * len(INERTIA)
    inertia = _the_one(inertial, "inertia", _owner(link))
    return [finite_number(_owner(link), name, inertia.get(name, "0")) for name in INERTIA]


def _check_places(owner: str, element: ET.Element) -> None:
    for origin in element.findall("origin"):
        for name in ("xyz", "rpy"):
            if name in origin.attrib:
                _vector(owner, f"origin {name}", origin.attrib[name])


def _vector(owner: str, name: str, text: str) -> list[float]:
    parts = text.split()
    if len(parts) != 3:
        raise RobotDescriptionError(f"{name}={quoted(text)} of {owner} must be three numbers")
    return [finite_number(owner, name, part) for part in parts]


def _the_one(element: ET.Element, tag: str, owner: str) -> ET.Element:
    found = element.findall(tag)
    if len(found) != 1:
        raise RobotDescriptionError(f"{owner} must have one {tag}")
    return found[0]


def _owner(element: ET.Element) -> str:
    return f"{element.tag} {shortened(element.get('name', ''))}"

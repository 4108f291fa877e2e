"""A URDF rewritten so that every simulator reads the same arm from it."""

from __future__ import annotations

import importlib.util
import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from pathlib import Path

from bus_schema.errors import RobotDescriptionError
from bus_schema.urdf.checks import (
    INERTIA,
    MOST_LINKS,
    MOVING_TYPES,
    inertia_of,
    joint_ends,
    mass_of,
)
from bus_schema.urdf.inertia import mend_inertias
from bus_schema.urdf.packages import find_package

PAYLOAD_LINK, PAYLOAD_JOINT = "funnel_hil_payload", "funnel_hil_payload_joint"
MOUNT_LINK, MOUNT_JOINT = "funnel_hil_mount", "funnel_hil_mount_joint"
_UNLIMITED = {"lower": -1e6, "upper": 1e6, "effort": 1e6, "velocity": 1e6}
_LEAST_MOMENT_KG_M2 = 1e-14
"""MuJoCo refuses smaller moments that are not zero."""
_OF_A_POINT = dict.fromkeys(("ixx", "iyy", "izz"), "1e-12")
"""Moments, kg m², of a mass without inertia that a joint moves: MuJoCo refuses zero."""
_NUMBERS = (
    *(f"link/inertial/{tag}" for tag in ("origin", "mass", "inertia")),
    *(f"joint/{tag}" for tag in ("origin", "axis", "limit")),
)
_NOT_OF_A_POSE = ("dynamics", "safety_controller", "calibration")
_SHAPES = (".obj", ".stl", ".dae")
"""Mesh files that pybullet can draw."""
_PYBULLET_DATA = "package://pybullet_data/"
"""Meshes of shipped arms, available if that Python package is installed."""


def resolve_joints(root: ET.Element, driven: AbstractSet[str], followers: AbstractSet[str]) -> None:
    """Make every joint revolute, prismatic or fixed, with unit axes and all four limits."""
    for joint in root.findall("joint"):
        name = joint.get("name")
        if name in driven or name in followers:
            _complete_limits(joint, endless=name in followers)
            _normalise_axis(joint)
        else:
            joint.set("type", "fixed")
            for limit in joint.findall("limit"):  # urdfdom refuses an incomplete one
                joint.remove(limit)
        for mimic in joint.findall("mimic"):  # the reader decides what follows
            joint.remove(mimic)


def resolve_inertias(root: ET.Element) -> None:
    """Replace impossible inertias and write all; pybullet would give 1 kg to missing ones."""
    mend_inertias(root)
    joints = [joint for joint in root.findall("joint") if joint.get("type") in MOVING_TYPES]
    moved = {joint_ends(joint)[1] for joint in joints}
    for link in root.findall("link"):
        is_point = link.get("name") in moved and mass_of(link) > 0.0
        for inertia in link.findall("inertial/inertia"):
            is_none = max(map(abs, inertia_of(link))) < _LEAST_MOMENT_KG_M2
            given = _OF_A_POINT if is_point else {}
            given = given if is_none else inertia.attrib
            inertia.attrib = {**dict.fromkeys(INERTIA, "0"), **given}
        if link.find("inertial") is None:
            _add_inertial(link, 0.0)


def write_plainly(root: ET.Element) -> None:
    """Drop what describes no body or joint, and write numbers as every reader takes them.

    urdfdom drops a link with a space after a number, and MuJoCo has elements of its own.
    """
    root.set("name", root.get("name") or "robot")
    for element in [each for each in root if each.tag not in ("link", "joint", "material")]:
        root.remove(element)
    for joint in root.findall("joint"):
        for unused in [each for each in joint if each.tag in _NOT_OF_A_POSE]:
            joint.remove(unused)
    for axis in root.iterfind("joint/axis"):
        axis.set("xyz", axis.get("xyz", "1 0 0"))
    for element in (each for tag in _NUMBERS for each in root.iterfind(tag)):
        for name, text in element.attrib.items():
            if name in ("xyz", "rpy", "value", *_UNLIMITED, *INERTIA):
                element.set(name, " ".join(repr(float(part)) for part in text.split()))


def drop_shapes(root: ET.Element, *, but_drawable: bool) -> None:
    """Remove visual and collision shapes, which rigid-body physics does not need.

    Args:
        root: the URDF, with absolute paths.
        but_drawable: keep shapes whose mesh files all exist and can be drawn.
    """
    for link in root.findall("link"):
        for kind in ("visual", "collision"):
            for shape in link.findall(kind):
                names = [mesh.get("filename", "") for mesh in shape.iter("mesh")]
                if not (but_drawable and all(_is_drawable(name) for name in names)):
                    link.remove(shape)


def name_meshes(root: ET.Element, base: Path, include: Sequence[Path] = ()) -> bool:
    """Write mesh files as absolute paths, and return whether there is any.

    Args:
        root: the URDF.
        base: its folder.
        include: folders with packages that the user names.
    """
    meshes = list(root.iter("mesh"))
    for mesh in meshes:
        mesh.set("filename", mesh_file(mesh.get("filename", ""), base, include))
    return bool(meshes)


def name_files(root: ET.Element) -> None:
    """Write mesh files with an absolute path as URIs, which RViz and Foxglove need."""
    for mesh in root.iter("mesh"):
        name = mesh.get("filename", "")
        if Path(name).is_absolute():
            mesh.set("filename", Path(name).as_uri())


def missing_meshes(root: ET.Element, base: Path) -> list[str]:
    """Return the names of mesh files that are missing or cannot be drawn, each once.

    Meshes of pybullet_data, which is optional, are not reported.
    """
    names = dict.fromkeys(mesh.get("filename", "") for mesh in root.iter("mesh"))
    return [
        name
        for name in names
        if not name.startswith(_PYBULLET_DATA) and not _is_drawable(mesh_file(name, base))
    ]


def pybullet_data() -> list[Path]:
    """Return the folder of the Python package pybullet_data; None if it is not installed."""
    spec = importlib.util.find_spec("pybullet_data")
    return [] if spec is None else [Path(each) for each in spec.submodule_search_locations or []]


def long_axes(root: ET.Element) -> list[str]:
    """Return names of moving joints whose axis is no unit vector."""
    return [
        joint.get("name", "")
        for joint in root.findall("joint")
        if joint.get("type") in MOVING_TYPES and abs(math.hypot(*_axis(joint)) - 1.0) > 1e-3
    ]


def attach_payload(root: ET.Element, tip_link: str, payload_kg: float) -> None:
    """Fix a point mass to the origin of the tip link."""
    link = ET.SubElement(root, "link", name=PAYLOAD_LINK)
    _add_inertial(link, payload_kg)
    joint = ET.SubElement(root, "joint", name=PAYLOAD_JOINT, type="fixed")
    ET.SubElement(joint, "parent", link=tip_link)
    ET.SubElement(joint, "child", link=PAYLOAD_LINK)


def attach_mount(root: ET.Element, base_rpy_rad: Sequence[float]) -> None:
    """Fix the base to the world with this orientation.

    Args:
        root: the URDF.
        base_rpy_rad: roll, pitch and yaw, as in the ``rpy`` of an origin.

    Raises:
        RobotDescriptionError: with another link there are too many.
    """
    links = [link.get("name", "") for link in root.findall("link")]
    if len(links) >= MOST_LINKS:
        allowed = f"a mounted arm (robot.base_rpy_rad) must have fewer than {MOST_LINKS}"
        raise RobotDescriptionError(f"has {len(links)} links; {allowed}")
    children = {joint_ends(joint)[1] for joint in root.findall("joint")}
    (base,) = (name for name in links if name not in children)
    ET.SubElement(root, "link", name=MOUNT_LINK)
    joint = ET.SubElement(root, "joint", name=MOUNT_JOINT, type="fixed")
    ET.SubElement(joint, "parent", link=MOUNT_LINK)
    ET.SubElement(joint, "child", link=base)
    ET.SubElement(joint, "origin", rpy=" ".join(map(repr, base_rpy_rad)))


def _complete_limits(joint: ET.Element, *, endless: bool) -> None:
    """Give a moving joint all four limits that simulators require."""
    limit = joint.find("limit")
    limit = ET.SubElement(joint, "limit") if limit is None else limit
    endless = endless or joint.get("type") == "continuous"
    for name, unlimited in _UNLIMITED.items():
        is_range = name in ("lower", "upper")
        if name not in limit.attrib or (endless if is_range else float(limit.attrib[name]) <= 0.0):
            limit.set(name, str(unlimited))
    if joint.get("type") == "continuous":
        joint.set("type", "revolute")


def _normalise_axis(joint: ET.Element) -> None:
    """Normalise an axis: simulators multiply torques by its length, or divide by it."""
    axis, direction = joint.find("axis"), _axis(joint)
    length = math.hypot(*direction)
    if axis is not None and length != 1.0:
        axis.set("xyz", " ".join(repr(part / length) for part in direction))


def _axis(joint: ET.Element) -> list[float]:
    axis = joint.find("axis")
    return [float(part) for part in ("1 0 0" if axis is None else axis.get("xyz", "1 0 0")).split()]


def _is_drawable(name: str) -> bool:
    path = Path(name.removeprefix("file://"))
    return path.suffix.lower() in _SHAPES and path.is_file()


def mesh_file(name: str, base: Path, include: Sequence[Path] = ()) -> str:
    """Return a mesh file's absolute path; a package may also be at or above the URDF's folder."""
    if not name.startswith("package://"):
        return name if "://" in name or Path(name).is_absolute() else str(base / name)
    inside = Path(name.removeprefix("package://"))
    for folder in (base, *base.parents, *pybullet_data()):
        for candidate in (folder / inside, folder / Path(*inside.parts[1:])):
            if candidate.is_file():
                return str(candidate)
    package = find_package(inside.parts[0], base / "urdf", include) if inside.parts else None
    return str(base / inside if package is None else package / Path(*inside.parts[1:]))


def _add_inertial(link: ET.Element, mass_kg: float) -> None:
    """Give `link` a point mass at its origin."""
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "mass", value=str(mass_kg))
    ET.SubElement(
        inertial, "inertia", dict.fromkeys(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), "0")
    )

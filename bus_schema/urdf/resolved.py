"""A URDF rewritten so that every simulator reads the same arm from it."""

from __future__ import annotations

import importlib.util
import math
import xml.etree.ElementTree as ET
from pathlib import Path

from bus_schema.urdf.checks import MOVING_TYPES
from bus_schema.urdf.inertia import mend_inertias

PAYLOAD_LINK, PAYLOAD_JOINT = "funnel_hil_payload", "funnel_hil_payload_joint"
_UNLIMITED = {"lower": -1e6, "upper": 1e6, "effort": 1e6, "velocity": 1e6}
_SHAPES = (".obj", ".stl", ".dae")
"""Mesh files that pybullet can draw."""
_PYBULLET_DATA = "package://pybullet_data/"
"""Meshes of shipped arms, available if that Python package is installed."""


def resolve_joints(root: ET.Element, driven: set[str], followers: set[str]) -> None:
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
    """Replace impossible inertias; remove empty ones, to which pybullet would give 1 kg."""
    mend_inertias(root)
    for link in root.findall("link"):
        if link.find("inertial") is None:
            _add_inertial(link, 0.0)


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


def name_meshes(root: ET.Element, base: Path) -> None:
    """Write mesh files as absolute paths.

    Args:
        root: the URDF.
        base: its folder.
    """
    for mesh in root.iter("mesh"):
        mesh.set("filename", _absolute(mesh.get("filename", ""), base))


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
        if not name.startswith(_PYBULLET_DATA) and not _is_drawable(_absolute(name, base))
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


def _complete_limits(joint: ET.Element, *, endless: bool) -> None:
    """Give a moving joint all four limits that simulators require."""
    limit = joint.find("limit")
    limit = ET.SubElement(joint, "limit") if limit is None else limit
    endless = endless or joint.get("type") == "continuous"
    for name, unlimited in _UNLIMITED.items():
        if limit.get(name) is None or (endless and name in ("lower", "upper")):
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


def _absolute(name: str, base: Path) -> str:
    """Return a mesh file's absolute path; a package is searched at and above the URDF's folder."""
    if not name.startswith("package://"):
        return name if "://" in name or Path(name).is_absolute() else str(base / name)
    inside = Path(name.removeprefix("package://"))
    for folder in (base, *base.parents, *pybullet_data()):
        for candidate in (folder / inside, folder / Path(*inside.parts[1:])):
            if candidate.is_file():
                return str(candidate)
    return str(base / inside)


def _add_inertial(link: ET.Element, mass_kg: float) -> None:
    """Give `link` a point mass at its origin."""
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "mass", value=str(mass_kg))
    ET.SubElement(
        inertial, "inertia", dict.fromkeys(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), "0")
    )

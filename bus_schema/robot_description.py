"""What a URDF file says about an arm, and a form of it that every simulator reads alike."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.errors import RobotDescriptionError
from bus_schema.urdf_checks import ACTUATED_TYPES, check_urdf, finite_number

PAYLOAD_LINK = "funnel_hil_payload"
_UNLIMITED = {"lower": -1e6, "upper": 1e6, "effort": 1e6, "velocity": 1e6}


@dataclass(frozen=True)
class RobotDescription:
    """An arm as its URDF describes it; joints in the order of the file.

    Attributes:
        path: the URDF file.
        text: its content.
        joint_names: names of the revolute and continuous joints; all others are held fixed.
        effort_limits_nm: largest torque of each joint (inf where the URDF has none).
        velocity_limits_rad_s: largest speed of each joint (inf where the URDF has none).
        lower_rad: lower end of each joint's range (-inf for continuous joints).
        upper_rad: upper end of each joint's range (inf for continuous joints).
        tip_link: the last link of the longest chain, which carries the payload.
    """

    path: Path
    text: str
    joint_names: tuple[str, ...]
    effort_limits_nm: Vector
    velocity_limits_rad_s: Vector
    lower_rad: Vector
    upper_rad: Vector
    tip_link: str

    @property
    def joints(self) -> int:
        return len(self.joint_names)

    def portable_urdf(self) -> str:
        """The URDF as it is, for another folder: mesh files by absolute path."""
        root = ET.fromstring(self.text)
        if root.find(".//mesh") is None:
            return self.text
        for mesh in root.iter("mesh"):
            mesh.set("filename", _absolute(mesh.get("filename", ""), self.path.parent))
        return ET.tostring(root, encoding="unicode")

    def resolved_urdf(self, payload_kg: float = 0.0) -> str:
        """The URDF with every joint either revolute or fixed, mesh files by absolute path.

        Args:
            payload_kg: point mass fixed to the origin of the tip link.
        """
        root = ET.fromstring(self.text)
        for joint in root.findall("joint"):
            if joint.get("type") in ACTUATED_TYPES:
                _complete_limits(joint)
            else:
                joint.set("type", "fixed")
        for mesh in root.iter("mesh"):
            mesh.set("filename", _absolute(mesh.get("filename", ""), self.path.parent))
        for link in root.findall("link"):
            if link.find("inertial") is None:  # pybullet would take it for a mass of 1 kg
                _add_inertial(link, 0.0)
        if payload_kg > 0.0:
            _attach_payload(root, self.tip_link, payload_kg)
        return ET.tostring(root, encoding="unicode")


def load_robot(path: Path) -> RobotDescription:
    """Read a URDF file.

    Raises:
        RobotDescriptionError: it cannot be read, is no URDF or has no revolute joint.
    """
    text, root = _parse(path)
    joints = [j for j in root.findall("joint") if j.get("type") in ACTUATED_TYPES]
    if not joints:
        raise RobotDescriptionError(f"{path} has no revolute or continuous joint")
    check_urdf(path, root)
    names = tuple(joint.get("name", "") for joint in joints)
    return RobotDescription(
        path=path,
        text=text,
        joint_names=names,
        effort_limits_nm=_limits(path, joints, "effort", math.inf),
        velocity_limits_rad_s=_limits(path, joints, "velocity", math.inf),
        lower_rad=_limits(path, joints, "lower", -math.inf),
        upper_rad=_limits(path, joints, "upper", math.inf),
        tip_link=_tip_link(root),
    )


def _complete_limits(joint: ET.Element) -> None:
    """Make an actuated joint revolute, with all four limits that simulators ask for."""
    limit = joint.find("limit")
    limit = ET.SubElement(joint, "limit") if limit is None else limit
    endless = joint.get("type") == "continuous"
    for name, unlimited in _UNLIMITED.items():
        if limit.get(name) is None or (endless and name in ("lower", "upper")):
            limit.set(name, str(unlimited))
    joint.set("type", "revolute")


def _absolute(name: str, base: Path) -> str:
    """Absolute path of a mesh file; a package's folder is looked for at and above the URDF's."""
    if not name.startswith("package://"):
        return name if "://" in name or Path(name).is_absolute() else str(base / name)
    inside = Path(name.removeprefix("package://"))
    for folder in (base, *base.parents):
        for candidate in (folder / inside, folder / Path(*inside.parts[1:])):
            if candidate.is_file():
                return str(candidate)
    return str(base / inside)


def _parse(path: Path) -> tuple[str, ET.Element]:
    try:
        text = path.read_text()
        root = ET.fromstring(text)
    except FileNotFoundError as error:
        raise RobotDescriptionError(f"{path} does not exist") from error
    except (OSError, UnicodeDecodeError, ET.ParseError) as error:
        raise RobotDescriptionError(f"{path} cannot be read as URDF: {error}") from error
    if root.tag != "robot":
        raise RobotDescriptionError(f"{path} is no URDF: its root element is <{root.tag}>")
    return text, root


def _limits(path: Path, joints: list[ET.Element], attribute: str, missing: float) -> Vector:
    is_range = attribute in ("lower", "upper")
    values = []
    for joint in joints:
        limit = joint.find("limit")
        text = None if limit is None else limit.get(attribute)
        if text is None or (is_range and joint.get("type") == "continuous"):
            values.append(missing)
            continue
        try:
            value = finite_number(f"joint {joint.get('name')}", attribute, text)
        except RobotDescriptionError as error:
            raise RobotDescriptionError(f"{path}: {error}") from error
        # A zero effort or velocity limit is how many exporters write "unknown".
        values.append(missing if value <= 0.0 and not is_range else value)
    return np.array(values)


def _tip_link(root: ET.Element) -> str:
    parents = {}
    for joint in root.findall("joint"):
        ends = {end.tag: end.get("link", "") for end in joint if end.tag in ("parent", "child")}
        parents[ends["child"]] = ends["parent"]

    def depth(link: str) -> int:
        steps = 0
        while link in parents and steps <= len(parents):
            link, steps = parents[link], steps + 1
        return steps

    return max(parents, key=depth)


def _attach_payload(root: ET.Element, tip_link: str, payload_kg: float) -> None:
    link = ET.SubElement(root, "link", name=PAYLOAD_LINK)
    _add_inertial(link, payload_kg)
    joint = ET.SubElement(root, "joint", name="funnel_hil_payload_joint", type="fixed")
    ET.SubElement(joint, "parent", link=tip_link)
    ET.SubElement(joint, "child", link=PAYLOAD_LINK)


def _add_inertial(link: ET.Element, mass_kg: float) -> None:
    """Give `link` a point mass at its origin."""
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "mass", value=str(mass_kg))
    ET.SubElement(
        inertial, "inertia", dict.fromkeys(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), "0")
    )

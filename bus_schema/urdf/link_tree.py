"""Links of a URDF as a tree: where they are at zero, and which joint moves them."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.urdf.checks import inertia_of, joint_ends, mass_of

Frame = tuple[Vector, Matrix]
"""Position, m, and rotation matrix."""


class LinkTree:
    """The links of a URDF, which passed `check_urdf`, with all joints at zero.

    Args:
        root: the URDF.

    Attributes:
        links: all links, by name.
        joints: the joint that carries each link except the base, by the link's name.
    """

    def __init__(self, root: ET.Element) -> None:
        self.links = {link.get("name", ""): link for link in root.findall("link")}
        ends = [(joint, *joint_ends(joint)) for joint in root.findall("joint")]
        self.joints = {child: joint for joint, _, child in ends}
        self._carriers = {child: parent for _, parent, child in ends}
        self._frames: dict[str, Frame] = {}

    def above(self, link: str) -> Iterator[ET.Element]:
        """Return the joints on the way from a link to the base."""
        while (joint := self.joints.get(link)) is not None:
            yield joint
            link = self._carriers[link]

    def mover(self, link: str, moving: set[str]) -> str | None:
        """Return the last of some joints on the way to a link."""
        names = (joint.get("name", "") for joint in self.above(link))
        return next((name for name in names if name in moving), None)

    def frame(self, link: str) -> Frame:
        """Return where a link is, seen from the base."""
        if link not in self._frames:
            joint = self.joints.get(link)
            at_base = (np.zeros(3), np.eye(3))
            carrier = at_base if joint is None else self.frame(self._carriers[link])
            self._frames[link] = carrier if joint is None else placed(carrier, joint)
        return self._frames[link]

    def axis(self, joint: ET.Element) -> tuple[Vector, Vector]:
        """Return a point of a joint's axis, and its direction."""
        at, turn = self.frame(joint_ends(joint)[1])
        return at, rotated(turn, axis_of(joint))

    def center(self, link: str) -> Frame:
        """Return the centre of mass of a link, with the axes of its moments of inertia."""
        inertial = self.links[link].find("inertial")
        frame = self.frame(link)
        return frame if inertial is None else placed(frame, inertial)

    def inertia_about(self, joint: ET.Element, link: str) -> float:
        """Return the inertia of one link about a joint's axis, kg m²."""
        (at, direction), (center, turn) = self.axis(joint), self.center(link)
        lever = np.cross(center - at, direction)
        moment = along(tensor_of(self.links[link]), turn, direction)
        return moment + mass_of(self.links[link]) * float((lever**2).sum())


def axis_of(joint: ET.Element) -> Vector:
    """Return the direction of a joint's axis in its own frame."""
    axis = joint.find("axis")
    text = "1 0 0" if axis is None else axis.get("xyz", "1 0 0")
    direction = np.array([float(part) for part in text.split()])
    return np.asarray(direction / np.sqrt((direction**2).sum()))


def tensor_of(link: ET.Element) -> Matrix:
    """Return a link's tensor of inertia about its centre of mass, kg m²."""
    xx, xy, xz, yy, yz, zz = inertia_of(link)
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def along(tensor: Matrix, turn: Matrix, direction: Vector) -> float:
    """Return the moment of inertia of a turned tensor about a direction."""
    own = rotated(turn.T, direction)
    return float((tensor * own[:, None] * own).sum())


def turned(tensor: Matrix, turn: Matrix) -> Matrix:
    """Return a tensor in the frame that it is turned into."""
    columns = np.array([rotated(turn, column) for column in tensor.T])
    return np.array([rotated(turn, row) for row in columns.T])


def rotated(turn: Matrix, vector: Vector) -> Vector:
    """Return a turned vector, without ``@``, which rounds as BLAS does on this CPU."""
    return np.asarray((turn * vector).sum(axis=1))


def placed(frame: Frame, element: ET.Element) -> Frame:
    """Return the frame of an element's ``<origin>``, which is relative to another frame."""
    (at, turn), origin = frame, element.find("origin")
    x, y, z, roll, pitch, yaw = (
        float(part)
        for name in ("xyz", "rpy")
        for part in ("0 0 0" if origin is None else origin.get(name, "0 0 0")).split()
    )
    (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    own = np.array(
        [[cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
         [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
         [-sp, cp * sr, cp * cr]]
    )  # fmt: skip
    return at + rotated(turn, np.array([x, y, z])), (turn[:, :, None] * own).sum(axis=1)

"""The pose of a URDF's joints that are held away from zero."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.urdf.joints import HeldJoint
from bus_schema.urdf.link_tree import axis_of, placed, rotated


def fix_held(root: ET.Element, held: Sequence[HeldJoint]) -> bool:
    """Make joints that are held away from zero fixed ones there, and return whether any is.

    Args:
        root: the URDF, which passed `check_urdf`.
        held: the joints that are held.
    """
    positions = {each.name: each.position for each in held if each.position}
    for joint in root.findall("joint"):
        if (position := positions.get(joint.get("name", ""))) is None:
            continue
        at, turn = placed((np.zeros(3), np.eye(3)), joint)
        axis = axis_of(joint)
        if joint.get("type") == "prismatic":
            at = at + position * rotated(turn, axis)
        else:
            turn = np.array([rotated(turn, column) for column in _turn(axis, position).T]).T
        for part in [each for each in joint if each.tag not in ("parent", "child")]:
            joint.remove(part)
        joint.set("type", "fixed")
        xyz, rpy = (" ".join(map(repr, each.tolist())) for each in (at, roll_pitch_yaw(turn)))
        ET.SubElement(joint, "origin", xyz=xyz, rpy=rpy)
    return bool(positions)


def _turn(axis: Vector, angle: float) -> Matrix:
    """Return the rotation about an axis (Rodrigues' formula)."""
    sine, cosine = math.sin(angle), math.cos(angle)
    columns = [
        cosine * unit + sine * np.cross(axis, unit) + (1.0 - cosine) * (axis * unit).sum() * axis
        for unit in np.eye(3)
    ]
    return np.array(columns).T


def roll_pitch_yaw(turn: Matrix) -> Vector:
    """Return roll, pitch and yaw of a rotation, exact at a pitch of 90 degrees too."""
    roll = math.atan2(turn[2, 1], turn[2, 2])
    sine, cosine = math.sin(roll), math.cos(roll)
    yaw = math.atan2(
        sine * turn[0, 2] - cosine * turn[0, 1], cosine * turn[1, 1] - sine * turn[1, 2]
    )
    pitch = math.atan2(-turn[2, 0], math.hypot(turn[2, 1], turn[2, 2]))
    return np.array([roll, pitch, yaw])

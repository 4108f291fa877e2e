"""Pose of each link of an arm in the frame of its parent link."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.robot_description import RobotDescription
from bus_schema.urdf.checks import MOVING_TYPES, joint_ends

Poses = NDArray[np.float64]
"""Translation (m) and unit quaternion x y z w in the last axis, of length 7."""


@dataclass(frozen=True)
class CarriedLink:
    """A link and its parent, by name; link names are frame names."""

    parent: str
    child: str


class LinkPoses:
    """Poses of all links but the root, each in its parent's frame.

    Args:
        robot: the arm.

    Attributes:
        fixed: links that do not move relative to their parents.
        moving: links that do, in the order of the URDF.
        fixed_poses: shape (fixed, 7).
    """

    def __init__(self, robot: RobotDescription) -> None:
        joints = ET.fromstring(robot.resolved_urdf(shapes="none")).findall("joint")
        moving = [joint for joint in joints if joint.get("type") in MOVING_TYPES]
        fixed = [joint for joint in joints if joint.get("type") not in MOVING_TYPES]
        self.fixed = tuple(CarriedLink(*joint_ends(joint)) for joint in fixed)
        self.moving = tuple(CarriedLink(*joint_ends(joint)) for joint in moving)
        self.fixed_poses = _origins(fixed)
        origins = _origins(moving)
        axes = np.array([_numbers(joint, "axis", "xyz", "1 0 0") for joint in moving])
        self._slides = np.array([joint.get("type") == "prismatic" for joint in moving])
        # A pose is a sum: the link's pose at joint position zero, and the part due to travel.
        self._places, self._untravelled, self._turned = np.zeros((3, len(moving), 7))
        self._places[:, :3], self._untravelled[:, 3:] = origins[:, :3], origins[:, 3:]
        self._turned[:, 3:] = _product(origins[:, 3:], axes)
        self._slid = np.zeros((len(moving), 7))
        self._slid[:, :3] = _rotated(origins[:, 3:], axes)
        names = [joint.get("name", "") for joint in moving]
        self._leaders, self._factors, self._offsets = _couplings(robot, names)

    def moving_poses(self, position: Vector) -> Poses:
        """Return the poses of the moving links, shape (moving, 7).

        Args:
            position: of the driven joints, shape (joints,), rad or m.
        """
        travel = position[self._leaders] * self._factors + self._offsets
        slide = np.where(self._slides, travel, 0.0)[:, None]
        half = 0.5 * (travel[:, None] - slide)
        poses: Poses = (
            self._places
            + slide * self._slid
            + np.cos(half) * self._untravelled
            + np.sin(half) * self._turned
        )
        return poses


def _couplings(
    robot: RobotDescription, moving: list[str]
) -> tuple[NDArray[np.int64], Vector, Vector]:
    """Return, for each moving joint, the driven joint that moves it, with factor and offset."""
    leaders = np.zeros(len(moving), dtype=np.int64)
    factors, offsets = np.ones(len(moving)), np.zeros(len(moving))
    for place, name in enumerate(robot.joint_names):
        leaders[moving.index(name)] = place
    for follower in robot.followers:
        row = moving.index(follower.name)
        leaders[row] = robot.joint_names.index(follower.leader)
        factors[row], offsets[row] = follower.multiplier, follower.offset
    return leaders, factors, offsets


def _origins(joints: list[ET.Element]) -> Poses:
    poses = [
        (*_numbers(joint, "origin", "xyz"), *_quaternion(*_numbers(joint, "origin", "rpy")))
        for joint in joints
    ]
    return np.array(poses).reshape(-1, 7)


def _numbers(joint: ET.Element, tag: str, attribute: str, default: str = "0 0 0") -> list[float]:
    element = joint.find(tag)
    text = default if element is None else element.get(attribute, default)
    return [float(part) for part in text.split()]


def _quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Return the quaternion x y z w of rotations about x, then y, then z of the parent."""
    (sr, cr), (sp, cp), (sy, cy) = (
        (math.sin(0.5 * angle), math.cos(0.5 * angle)) for angle in (roll, pitch, yaw)
    )
    return (
        sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy, cr * cp * cy + sr * sp * sy,
    )  # fmt: skip


def _product(quaternions: Poses, vectors: Matrix) -> Matrix:
    """Multiply quaternions and vectors as quaternions x y z w, row by row."""
    a, w = quaternions[:, :3], quaternions[:, 3:]
    scalar = -np.sum(a * vectors, axis=1, keepdims=True)
    return np.hstack([w * vectors + np.cross(a, vectors), scalar])


def _rotated(quaternions: Poses, vectors: Matrix) -> Matrix:
    """Rotate vectors by quaternions, row by row."""
    a, w = quaternions[:, :3], quaternions[:, 3:]
    twice = 2.0 * np.cross(a, vectors)
    return np.asarray(vectors + w * twice + np.cross(a, twice))

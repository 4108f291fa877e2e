"""Messages that show a recording or a live bus in 3-D: the arm, and the poses of its links.

It works like robot_state_publisher and reads only the joint states as they were delivered.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.errors import InvalidMessageError
from bus_schema.messages.record import Record
from bus_schema.messages.topics import (
    JOINT_COMMANDS,
    JOINT_STATES,
    ROBOT_DESCRIPTION,
    TF_STATIC,
    Topic,
    layout,
)
from bus_schema.messages.types import NANOSECONDS, STRING, TF_MESSAGE, TYPESTORE, split_stamp
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


def encode_transforms(links: Sequence[CarriedLink], stamp_ns: int, poses: Poses) -> bytes:
    """Encode link poses as one message.

    Args:
        links: the links, in the order of `poses`.
        stamp_ns: time of the poses.
        poses: shape (links, 7).
    """
    types = TYPESTORE.types
    header, transform = types["std_msgs/msg/Header"], types["geometry_msgs/msg/Transform"]
    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    stamped = types["geometry_msgs/msg/TransformStamped"]
    stamp = types["builtin_interfaces/msg/Time"](*split_stamp(stamp_ns))
    transforms = []
    for link, pose in zip(links, poses.tolist(), strict=True):
        placed = transform(vector(*pose[:3]), quaternion(*pose[3:]))
        transforms.append(stamped(header(stamp, link.parent), link.child, placed))
    return bytes(TYPESTORE.serialize_cdr(types[TF_MESSAGE](transforms), TF_MESSAGE))


PLUGIN = "joint_state_topic_hardware_interface/JointStateTopicSystem"
_PARAMETERS = {
    "joint_commands_topic": f"/{JOINT_COMMANDS.name}",
    "joint_states_topic": f"/{JOINT_STATES.name}",
    # Without it, a command is left out where it is close to the measured torque.
    "trigger_joint_command_threshold": "-1",
}


def with_ros2_control(urdf: str, joint_names: Sequence[str]) -> str:
    """Return a URDF with a ``ros2_control`` element: torque commands; position and other states.

    Args:
        urdf: the URDF; its existing ``ros2_control`` elements are removed.
        joint_names: names of the driven joints; followers are not on the bus.
    """
    root = ET.fromstring(urdf)
    for own in root.findall("ros2_control"):
        root.remove(own)
    system = ET.SubElement(root, "ros2_control", name="funnel_hil", type="system")
    hardware = ET.SubElement(system, "hardware")
    ET.SubElement(hardware, "plugin").text = PLUGIN
    for name, value in _PARAMETERS.items():
        ET.SubElement(hardware, "param", name=name).text = value
    for name in joint_names:
        joint = ET.SubElement(system, "joint", name=name)
        ET.SubElement(joint, "command_interface", name="effort")
        for kind in ("position", "velocity", "effort"):
            ET.SubElement(joint, "state_interface", name=kind)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode")


_PERIOD_NS = NANOSECONDS // 60
"""Shortest time between two pictures: screens show no more."""


def description(robot: RobotDescription) -> str:
    """Return the URDF for `ROBOT_DESCRIPTION`: for viewers, and for ros2_control."""
    return with_ros2_control(robot.viewer_urdf(), robot.joint_names)


class ArmView:
    """Encoder of messages on `VIEW_TOPICS`.

    Args:
        robot: the arm.
    """

    def __init__(self, robot: RobotDescription) -> None:
        self._robot = robot
        self._poses = LinkPoses(robot)
        self._layout = layout(JOINT_STATES, robot.joint_names)
        self._state = Record(self._layout)
        self._last_ns: int | None = None

    def first(self) -> list[tuple[Topic, bytes]]:
        """Return the messages sent once: the URDF, and the poses of fixed links."""
        text = TYPESTORE.types[STRING](description(self._robot))
        static = encode_transforms(self._poses.fixed, 0, self._poses.fixed_poses)
        return [
            (ROBOT_DESCRIPTION, bytes(TYPESTORE.serialize_cdr(text, STRING))),
            (TF_STATIC, static),
        ]

    def transforms(self, state: bytes, stamp_ns: int) -> bytes | None:
        """Return the transforms to send on `TF` with a joint state; None if no picture is due.

        Args:
            state: the joint state as received; an invalid one has no picture.
            stamp_ns: its stamp.
        """
        if self._last_ns is not None and abs(stamp_ns - self._last_ns) < _PERIOD_NS:
            return None
        try:
            self._layout.decode(state, self._state)
        except InvalidMessageError:
            return None
        position = self._state.fields["position"]
        if not np.isfinite(position).all():
            return None
        self._last_ns = stamp_ns
        poses = self._poses.moving_poses(position)
        return encode_transforms(self._poses.moving, stamp_ns, poses)

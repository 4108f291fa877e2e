"""Messages that show a recording or a live bus in 3-D: the arm, and the poses of its links.

It works like robot_state_publisher and reads only the joint states as they were delivered.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence

import numpy as np

from bus_schema.errors import InvalidMessageError
from bus_schema.messages.header import NANOSECONDS, split_stamp
from bus_schema.messages.layout import Record
from bus_schema.messages.topics import (
    JOINT_COMMANDS,
    JOINT_STATES,
    ROBOT_DESCRIPTION,
    TF_STATIC,
    Topic,
    layout,
)
from bus_schema.messages.types import STRING, TF_MESSAGE, TYPESTORE
from bus_schema.robot_description import RobotDescription
from bus_schema.view.link_poses import CarriedLink, LinkPoses, Poses


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

"""The arm's description, which libfranka reads when it connects."""

from __future__ import annotations

import xml.etree.ElementTree as ET

from bus_schema.robot_description import RobotDescription

_NAME = "joint{}"
"""Name that libfranka expects of a joint, counted from 1."""
_LIMITS = "position_based_velocity_limits"
_SLOWS_RAD_S2 = "10"
"""Deceleration from which libfranka derives speeds near the ends of joints without such limits."""


def described(robot: RobotDescription) -> bytes:
    """Return the URDF of an arm, with the names of joints that libfranka expects."""
    root = ET.fromstring(robot.resolved_urdf())
    names = {name: _NAME.format(number) for number, name in enumerate(robot.joint_names, 1)}
    for number, joint in enumerate(root.findall("joint")):
        name = names.get(joint.get("name", ""))
        joint.set("name", name or f"other{number}")
        if name is not None and joint.find(_LIMITS) is None:
            ET.SubElement(joint, _LIMITS, velocity_offset="0", deceleration_limit=_SLOWS_RAD_S2)
    return ET.tostring(root)

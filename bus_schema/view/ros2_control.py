"""The part of a robot's description that tells ros2_control how to reach the arm: by topics.

As of joint_state_topic_hardware_interface 1.1, whose effort-only commands it needs; its older name
is topic_based_ros2_control.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence

from bus_schema.messages.topics import JOINT_COMMANDS, JOINT_STATES

PLUGIN = "joint_state_topic_hardware_interface/JointStateTopicSystem"
_PARAMETERS = {
    "joint_commands_topic": f"/{JOINT_COMMANDS.name}",
    "joint_states_topic": f"/{JOINT_STATES.name}",
    # Else a command is left out where it differs little from the torque that was measured.
    "trigger_joint_command_threshold": "-1",
}


def with_ros2_control(urdf: str, joint_names: Sequence[str]) -> str:
    """A URDF with its element ``ros2_control``: torques commanded, positions and more measured.

    Args:
        urdf: the URDF; what it says of ros2_control of its own is left out.
        joint_names: of the driven joints; those that follow them are not on the bus.
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

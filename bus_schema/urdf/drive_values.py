"""What a URDF says of the motors and gears at its joints.

``<dynamics damping friction>`` of a joint, and in the ``<transmission>`` of one joint alone its
``<actuator>`` with rotor_inertia (value or text, kg m², in any namespace, such as Drake's) and, if
that is of the motor's own shaft, gear_ratio or mechanicalReduction. Exporters write zero for what
they do not know.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.urdf.checks import finite_number

_RATIOS = ("gear_ratio", "mechanicalReduction")


class DriveValues(NamedTuple):
    """Of each joint, as felt there; shape (joints,), zero where the file says nothing.

    Attributes:
        rotor_inertia_kg_m2: inertia of the rotor times the gear ratio squared.
        friction_nm: dry friction.
        damping_nm_s: viscous friction.
    """

    rotor_inertia_kg_m2: Vector
    friction_nm: Vector
    damping_nm_s: Vector


def drive_values(root: ET.Element, joint_names: Sequence[str]) -> DriveValues:
    """The values of some joints.

    Raises:
        RobotDescriptionError: one is no number.
    """
    rotors = dict(_rotor(each) for each in root.findall("transmission"))
    found = {joint.get("name"): joint.find("dynamics") for joint in root.findall("joint")}

    def dynamics(attribute: str) -> Vector:
        texts = {name: each.get(attribute, "0") for name, each in found.items() if each is not None}
        values = [
            finite_number(f"joint {name}", attribute, texts.get(name, "0")) for name in joint_names
        ]
        return np.maximum(values, 0.0)

    inertia = np.array([rotors.get(name, 0.0) for name in joint_names])
    return DriveValues(inertia, dynamics("friction"), dynamics("damping"))


def _rotor(transmission: ET.Element) -> tuple[str | None, float]:
    """The joint of a transmission, and the inertia of its rotor as felt there; zero for none."""
    joints, values = transmission.findall("joint"), dict[str, float]()
    if len(joints) != 1:
        return None, 0.0
    name = joints[0].get("name")
    for element in transmission.findall("actuator/*"):
        tag = element.tag.rpartition("}")[2]
        if tag in ("rotor_inertia", *_RATIOS):
            text = element.get("value") or element.text or ""
            values[tag] = finite_number(f"the transmission of joint {name}", tag, text)
    ratio = next((values[tag] for tag in _RATIOS if tag in values), 1.0)
    return name, max(0.0, values.get("rotor_inertia", 0.0)) * ratio**2

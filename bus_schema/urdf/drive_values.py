"""Motor and gear values that a URDF gives for its joints.

``<dynamics damping friction>`` of a joint, and in the ``<transmission>`` of one joint alone its
``<actuator>`` with rotor_inertia (value or text, kg m², in any namespace, such as Drake's) and, if
that is of the motor's own shaft, gear_ratio or mechanicalReduction. Exporters write zero for
unknown values; a text that is no number counts as unknown too.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Vector

_RATIOS = ("gear_ratio", "mechanicalReduction")
_LARGEST = 1e6
"""Physics cannot be computed with values beyond this."""


class DriveValues(NamedTuple):
    """Drive values at each joint; shape (joints,), zero where the file says nothing.

    Attributes:
        rotor_inertia_kg_m2: inertia of the rotor times the gear ratio squared.
        friction_nm: dry friction.
        damping_nm_s: viscous friction.
    """

    rotor_inertia_kg_m2: Vector
    friction_nm: Vector
    damping_nm_s: Vector


def drive_values(root: ET.Element, joint_names: Sequence[str]) -> DriveValues:
    """Return the values of some joints."""
    rotors = dict(_rotor(each) for each in root.findall("transmission"))
    found = {joint.get("name"): joint.find("dynamics") for joint in root.findall("joint")}

    def dynamics(attribute: str) -> Vector:
        texts = {name: each.get(attribute, "0") for name, each in found.items() if each is not None}
        return np.array([_number(texts.get(name, "0")) for name in joint_names])

    inertia = np.array([rotors.get(name, 0.0) for name in joint_names])
    return DriveValues(inertia, dynamics("friction"), dynamics("damping"))


def _rotor(transmission: ET.Element) -> tuple[str | None, float]:
    """Return a transmission's joint, and its rotor's inertia as felt there; zero without one."""
    joints, values = transmission.findall("joint"), dict[str, float]()
    if len(joints) != 1:
        return None, 0.0
    name = joints[0].get("name")
    for element in transmission.findall("actuator/*"):
        tag = element.tag.rpartition("}")[2]
        if tag in ("rotor_inertia", *_RATIOS):
            values[tag] = _number(element.get("value") or element.text or "")
    ratio = next((values[tag] for tag in _RATIOS if tag in values), 1.0)
    return name, values.get("rotor_inertia", 0.0) * ratio**2


def _number(text: str) -> float:
    """Return the positive number in a text, else zero."""
    try:
        value = float(text)
    except ValueError:
        return 0.0
    return value if 0.0 < value < _LARGEST else 0.0

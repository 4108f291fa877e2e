"""Motor and gear values that a URDF gives for its joints.

``<dynamics damping friction>`` of a joint, and in the ``<transmission>`` of one joint alone its
``<actuator>`` with rotor_inertia (value or text, kg m², in any namespace, such as Drake's) and, if
that is of the motor's own shaft, gear_ratio or mechanicalReduction; and with the other values of
`MOTOR_VALUES`, which our conversion of MJCF writes there. Exporters write zero for unknown values,
and a text that is no number counts as unknown too.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Vector

MOTOR_VALUES = {
    "rotor_inertia": "rotor_inertia_kg_m2",
    "stiffness": "servo_stiffness_nm_rad",
    "damping": "servo_damping_nm_s",
    "delay": "delay_s",
    "lag": "lag_s",
    "rated_speed": "rated_speed_rad_s",
    "no_load_speed": "no_load_speed_rad_s",
    "cogging": "cogging_nm",
    "cogging_periods": "cogging_periods",
    "stribeck": "stribeck_nm",
    "stribeck_velocity": "stribeck_velocity_rad_s",
}
"""Elements of an ``<actuator>``, and their fields in `DriveValues`."""
_RATIOS = ("gear_ratio", "mechanicalReduction")
_LARGEST = 1e6
"""Physics cannot be computed with values beyond this."""


class DriveValues(NamedTuple):
    """Drive values at each joint; shape (joints,), zero where the file says nothing.

    Attributes:
        friction_nm: dry friction.
        damping_nm_s: viscous friction.
        rotor_inertia_kg_m2: inertia of the rotor times the gear ratio squared.
        servo_stiffness_nm_rad: gain of the drive's own loop around a target position.
        servo_damping_nm_s: its gain around a target velocity.
        delay_s: dead time of the actuator.
        lag_s: its time constant.
        rated_speed_rad_s: up to this speed the largest torque is available.
        no_load_speed_rad_s: at this speed there is no torque.
        cogging_nm: amplitude of the cogging torque.
        cogging_periods: its periods per turn.
        stribeck_nm: dry friction beyond `friction_nm` near standstill.
        stribeck_velocity_rad_s: speed over which that decays.
    """

    friction_nm: Vector
    damping_nm_s: Vector
    rotor_inertia_kg_m2: Vector
    servo_stiffness_nm_rad: Vector
    servo_damping_nm_s: Vector
    delay_s: Vector
    lag_s: Vector
    rated_speed_rad_s: Vector
    no_load_speed_rad_s: Vector
    cogging_nm: Vector
    cogging_periods: Vector
    stribeck_nm: Vector
    stribeck_velocity_rad_s: Vector


def drive_values(root: ET.Element, joint_names: Sequence[str]) -> DriveValues:
    """Return the values of some joints."""
    motors = dict(_motor(each) for each in root.findall("transmission"))
    found = {joint.get("name"): joint.find("dynamics") for joint in root.findall("joint")}

    def dynamics(attribute: str) -> Vector:
        texts = {name: each.get(attribute, "0") for name, each in found.items() if each is not None}
        return np.array([_number(texts.get(name, "0")) for name in joint_names])

    def motor(tag: str) -> Vector:
        return np.array([motors.get(name, {}).get(tag, 0.0) for name in joint_names])

    of_motors = {field: motor(tag) for tag, field in MOTOR_VALUES.items()}
    return DriveValues(dynamics("friction"), dynamics("damping"), **of_motors)


def _motor(transmission: ET.Element) -> tuple[str | None, dict[str, float]]:
    """Return a transmission's joint, and values of its motor, the rotor's inertia as felt there."""
    joints = transmission.findall("joint")
    if len(joints) != 1:
        return None, {}
    values = {
        element.tag.rpartition("}")[2]: _number(element.get("value") or element.text or "")
        for element in transmission.findall("actuator/*")
    }
    ratio = next((values[tag] for tag in _RATIOS if tag in values), 1.0)
    values["rotor_inertia"] = values.get("rotor_inertia", 0.0) * ratio**2
    return joints[0].get("name"), values


def _number(text: str) -> float:
    """Return the positive number in a text, else zero."""
    try:
        value = float(text)
    except ValueError:
        return 0.0
    return value if 0.0 < value < _LARGEST else 0.0

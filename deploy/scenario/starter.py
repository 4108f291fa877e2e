"""A first scenario for an arm, from its URDF or MJCF file alone.

Missing values are estimated: inertia of rotors and friction from the joints' largest torques, and
these, if they are missing too, from the arm's own weight. The estimates are ours; motors of the
same torque differ by a factor of 3 and more. ``robot.drive_data`` names them.
"""

from __future__ import annotations

import math
import re
from typing import Any, NamedTuple

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.robot_description import RobotDescription, load_robot
from bus_schema.urdf.arm_sizes import arm_sizes
from bus_schema.urdf.drive_values import DriveValues
from controller.manipulator_model import ManipulatorModel
from deploy.scenario.checking.plausibility import (
    MOST_NM_PER_KG,
    USUAL_RAD_S2,
    Loads,
    heavy_rotors,
    loads_of,
    motor_kg,
    placeholders,
)
from deploy.scenario.referenced_files import ROBOTS
from deploy.scenario.starter_motion import middle_and_move, move_time, slow_speeds, start_offsets
from deploy.scenario.yaml_files import read_yaml
from plant_emulator.configuration import ROTOR_INERTIA_S2_RAD

ARM_FILES = (".urdf", ".xacro", ".xml", ".mjcf")
"""Suffixes of files that describe an arm."""
FRICTION_SHARE = 0.05
"""Dry friction of a geared joint, as a share of its rated torque.

Identified on a UR10e and a UR10: 3.3 to 6.7 % (12 joints); beyond a Panda's gears 0.2 to 2.2 %.
"""
VISCOUS_SHARE_S, _VISCOUS_AT_TOP_SPEED = 0.06, 0.2
"""Viscous friction per rad/s, as a share of rated torque, and its largest share at top speed.

Identified on the same: 0.042 to 0.065 s, 9 to 19 % at top speed; beyond a Panda's gears none.
"""
_RATE_PER_S = 4.0
_FEWEST_MOVES, _LEAST_S = 4, 3.0 + 10.0 / _RATE_PER_S
"""A delay that grows in a running loop has its full size after 3 s, and must then last ten time
constants of the funnel for a margin."""
_FRICTION_SHARE_BELIEVED = 0.2
"""Largest plausible friction in a file."""
ESTIMATED = "ESTIMATED"
"""Mark of estimated numbers where a scenario names the source of its numbers."""
_NO_SUCH_SPEED = 1e6
"""rad/s, of motors whose torque does not fall with their speed."""
_LEAST_LOAD = 0.1
"""N m of gravity per kg m², below which it loads no joint, as of an arm that lies on its side."""
_HARDLY_LOADED, _NOT_LOADED = 0.2, 1e-6
"""Share of the torque by a neighbour's, below which gravity says little about a motor; and share of
the arm's largest, below which it says nothing."""


class Drives(NamedTuple):
    """Motors and friction of an arm.

    Attributes:
        rated: largest torques, shape (joints,), N m.
        rotors: inertia of the rotors, shape (joints,), kg m².
        friction: section ``plant.friction``.
        data: source of these values; `ESTIMATED` marks estimates.
    """

    rated: Vector
    rotors: Vector
    friction: dict[str, Any]
    data: str


def starter_scenario(robot: RobotDescription) -> dict[str, Any]:
    """Return the values of a scenario that moves an arm to and fro, at rest at both ends."""
    rated, rotors, friction, data = drives_of(robot)
    model = ManipulatorModel(robot, rotor_inertia_kg_m2=rotors)
    middle, move = middle_and_move(robot, model, rated)
    move_s = move_time(robot, model, rated, middle, move)
    moves = max(_FEWEST_MOVES, 2 * math.ceil(0.5 * _LEAST_S / move_s))
    ends = [middle - move, middle + move]
    waypoints = [
        {"time_s": round(number * move_s, 3), "position_rad": _rounded(ends[number % 2])}
        for number in range(moves + 1)
    ]
    offsets = start_offsets(model, rated, middle - move, move)
    return {
        "name": re.sub(r"[^A-Za-z0-9_.-]", "_", robot.path.stem).lstrip("_.-") or "arm",
        "duration_s": round(moves * move_s, 3),
        "seed": 1,
        "robot": {
            "urdf": str(robot.path),
            **robot.reading,
            "drive_data": ", ".join(filter(None, [robot.estimated, data])),
            "initial_offset_rad": _rounded(offsets),
        },
        "reference": {"kind": "minimum_jerk", "waypoints": waypoints},
        "funnel": {
            "final_rad": _rounded(np.minimum(0.01, 0.2 * np.abs(move))),
            "rate_per_s": _RATE_PER_S,
        },
        "controller": {"law": "fixed_time_adaptive"},
        "plant": {
            "physics": {"engine": "mujoco"},
            "actuator": {
                "rotor_inertia_kg_m2": _rounded(rotors),
                "saturation_nm": _rounded(rated),
                **actuator_values(robot.drives),
            },
            "friction": friction,
            **drive_feedback(robot.drives),
        },
        "limits": {"torque_nm": _rounded(rated)},
    }


def drives_of(robot: RobotDescription) -> Drives:
    """Return an arm's drives, from the shipped scenario for its motors or from its file."""
    motors = ROBOTS.with_name("scenarios") / f"{robot.path.stem}_motors.yaml"
    if robot.path.parent == ROBOTS and motors.is_file():
        published = read_yaml(motors)
        plant, data = published["plant"], published["robot"]["drive_data"]
        actuator = plant["actuator"]
        names = load_robot(robot.path).joint_names
        places = [names.index(name) for name in robot.joint_names]
        rated = torque_limits(robot)
        if "saturation_nm" in actuator:
            rated = np.array(actuator["saturation_nm"], float)[places]
        published_friction = {
            key: [each[place] for place in places] if isinstance(each, list) else each
            for key, each in plant["friction"].items()
        }
        rotors = np.array(actuator["rotor_inertia_kg_m2"])[places]
        return Drives(rated, rotors, published_friction, data)
    rated = torque_limits(robot)
    own = _drives_in_file(robot, rated)
    rotors = own.rotor_inertia_kg_m2
    rotors = np.where(rotors > 0.0, rotors, ROTOR_INERTIA_S2_RAD * rated)
    given = {"coulomb_nm": own.friction_nm, "viscous_nm_s": own.damping_nm_s}
    friction: dict[str, Any] = {key: _rounded(each) for key, each in given.items() if each.any()}
    if not own.friction_nm.all():
        shares = np.where(own.friction_nm > 0.0, 0.0, FRICTION_SHARE)
        friction["coulomb_share"] = shares.tolist() if own.friction_nm.any() else FRICTION_SHARE
    speeds = np.where(np.isfinite(robot.velocity_limits_rad_s), robot.velocity_limits_rad_s, 0)
    viscous_s = np.minimum(VISCOUS_SHARE_S, _VISCOUS_AT_TOP_SPEED / np.maximum(speeds, 1e-3))
    if not own.damping_nm_s.all():
        friction["viscous_share_s"] = _rounded(np.where(own.damping_nm_s > 0.0, 0.0, viscous_s))
    if own.stribeck_nm.any():
        friction["stribeck_nm"] = _rounded(own.stribeck_nm)
        speeds = np.where(own.stribeck_velocity_rad_s > 0.0, own.stribeck_velocity_rad_s, 0.1)
        friction["stribeck_velocity_rad_s"] = _rounded(speeds)
    friction["smoothing_velocity_rad_s"] = 0.02
    sources = (
        ("rotor inertia", own.rotor_inertia_kg_m2, f"{ROTOR_INERTIA_S2_RAD} kg m² per N m"),
        ("dry friction", own.friction_nm, f"{100 * FRICTION_SHARE:g} %"),
        ("viscous friction", own.damping_nm_s, f"{_span(viscous_s[own.damping_nm_s == 0.0])} s"),
    )
    data = [_source(*each) for each in sources]
    if not np.array_equal(rated, robot.effort_limits_nm):
        why = "none" if not np.isfinite(robot.effort_limits_nm).all() else "a placeholder"
        data.insert(0, f"largest torques {ESTIMATED} from its weight if its file has {why}")
    return Drives(rated, rotors, friction, ", ".join(data))


def _span(values: Vector) -> str:
    """Return the smallest and the largest of some values; one number where they are the same."""
    ends = dict.fromkeys(
        f"{each:.3g}" for each in (values.min(initial=np.inf), values.max(initial=0))
    )
    return " to ".join(ends)


def drive_feedback(drives: DriveValues) -> dict[str, Any]:
    """Return gains of the drives' own loops; zero for joints without one."""
    gains = {
        "stiffness_nm_rad": drives.servo_stiffness_nm_rad, "damping_nm_s": drives.servo_damping_nm_s
    }  # fmt: skip
    has_loops = any(each.any() for each in gains.values())
    known = {key: _rounded(each) for key, each in gains.items()}
    return {"drive_feedback": known} if has_loops else {}


def actuator_values(drives: DriveValues) -> dict[str, Any]:
    """Return what else the file says about motors, for section ``plant.actuator``."""
    values: dict[str, Any] = {}
    for key, seconds in (("delay_ms", drives.delay_s), ("lag_ms", drives.lag_s)):
        if seconds.any():
            values[key] = float(f"{1e3 * seconds.max():.4g}")
    free = drives.no_load_speed_rad_s
    if free.any():
        unlimited = np.where(free > 0.0, free, _NO_SUCH_SPEED)
        rated = np.where(free > 0.0, drives.rated_speed_rad_s, 0.5 * _NO_SUCH_SPEED)
        values["rated_speed_rad_s"], values["no_load_speed_rad_s"] = map(
            _rounded, (rated, unlimited)
        )
    if drives.cogging_nm.any():
        values["cogging_nm"] = _rounded(drives.cogging_nm)
        values["cogging_periods"] = float(drives.cogging_periods.max())
    return values


def _drives_in_file(robot: RobotDescription, rated: Vector) -> DriveValues:
    """Return the drives in an arm's file, without friction and rotors that no motor has.

    Many files have 1 N m for every joint, from a template, and damping and inertia that stabilise a
    simulation.
    """
    own = robot.drives
    rotors = np.where(heavy_rotors(robot), 0.0, own.rotor_inertia_kg_m2)
    dry, viscous = own.friction_nm, own.damping_nm_s * slow_speeds(robot)
    return own._replace(
        rotor_inertia_kg_m2=rotors,
        friction_nm=np.where(dry <= _FRICTION_SHARE_BELIEVED * rated, dry, 0.0),
        damping_nm_s=np.where(viscous <= _FRICTION_SHARE_BELIEVED * rated, own.damping_nm_s, 0.0),
    )


def _source(name: str, known: Vector, estimate: str) -> str:
    """Describe the source of a number that is zero for joints without a value in the file."""
    parts = ["from the arm's file"] if known.any() else []
    if not known.all():
        parts.append(f"{ESTIMATED} as {estimate} of the largest torque")
    return f"{name} {' and elsewhere '.join(parts)}"


def torque_limits(robot: RobotDescription) -> Vector:
    """Return rated torques, shape (joints,), N m.

    Where the file has none or a placeholder, three times what the arm needs to hold itself up in
    the worst of many postures, or to accelerate if gravity loads no joint; and at least a hundredth
    of the largest. A joint that gravity hardly loads, such as a vertical one, has the torque of a
    neighbour in the ratio of their inertias. No estimate exceeds the placeholder, or what links of
    this mass bear.
    """
    limits, loads = robot.effort_limits_nm.copy(), loads_of(robot)
    unknown = ~np.isfinite(limits) | placeholders(robot, loads, limits).is_one
    if unknown.any():
        found = _estimated_torques(robot, loads, np.where(unknown, np.nan, limits))
        most = MOST_NM_PER_KG * np.where(robot.slides, np.inf, motor_kg(robot))
        limits[unknown] = np.minimum(np.minimum(found, most), limits)[unknown]
    return limits


def _estimated_torques(robot: RobotDescription, loads: Loads, known: Vector) -> Vector:
    """Return estimates of largest torques, shape (joints,), N m; see `torque_limits`.

    Args:
        robot: the arm.
        loads: of its joints.
        known: the largest torques that are known, NaN for others.
    """
    unknown, carriers = np.isnan(known), arm_sizes(robot.text, robot.joint_names).carriers
    is_loaded = loads.gravity_nm.max() > _LEAST_LOAD * loads.inertia_kg_m2.max()
    held = 3.0 * (loads.gravity_nm if is_loaded else USUAL_RAD_S2 * loads.inertia_kg_m2)

    def by_neighbour() -> Vector:
        """Return the torque by the ratio of inertia to those that carry a joint or are carried."""
        rates = np.where(unknown, held, known) / np.maximum(loads.inertia_kg_m2, 1e-9)
        beside = np.zeros_like(held)
        for joint, carrier in enumerate(carriers):
            if carrier >= 0:
                beside[joint] = max(beside[joint], rates[carrier])
                beside[carrier] = max(beside[carrier], rates[joint])
        return np.asarray(beside * loads.inertia_kg_m2)

    found = by_neighbour()
    held = np.where(held < _HARDLY_LOADED * found, found, held)
    for _ in carriers:  # as a vertical waist that carries vertical shoulders
        held = np.where(held < _NOT_LOADED * held.max(), np.maximum(held, by_neighbour()), held)
    return np.asarray(np.maximum(held, 0.01 * max(held.max(), 1.0)))


def _rounded(values: Vector | Matrix) -> list[float]:
    """Round values to four digits, as a person would write them."""
    return [float(f"{value:.4g}") for value in values]

"""Motor and gear of each joint: from the requested torque to the torque at the link.

At the joint, a rotor has its inertia times the gear ratio squared, in most geared joints the
largest share of the inertia. With a rigid gear, the physics engine adds it to the joint. With an
elastic gear, rotor and link are two masses, with the angle θ of the rotor (beyond the gear) and q
of the link:

    J θ̈ = τ − friction − cogging − τ_g,    τ_g = k (θ − q) + d (θ̇ − q̇),

and τ_g moves the link. After Spong, "Modeling and control of elastic joint robots", J. Dyn. Syst.
Meas. Control 109 (1987).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Matrix, Records, Vector, records
from bus_schema.configuration import ConfigurationError, expand
from bus_schema.robot_description import RobotDescription
from bus_schema.runtime.compiled import compiled
from plant_emulator.configuration import (
    ActuatorConfiguration,
    FrictionConfiguration,
    Integrator,
)

_KEY = "plant.actuator"


class DriveTrains(NamedTuple):
    """Motors and gears for compiled code.

    Attributes:
        joints: of each joint, by name, shape (joints,): saturation_nm, rated_speed_rad_s,
            no_load_speed_rad_s (inf for none), cogging_nm, and of elastic gears stiffness_nm_rad,
            damping_nm_s and rotor_kg_m2.
        lag_factor: share of the difference to the commanded torque that remains after a substep.
        cogging_per_rad: phase of the cogging torque over the joint's angle.
        is_elastic: whether the gears are.
        substep_s: length of a physics step.
        lead_s: time after the start of a step at which gears and cogging are evaluated, see
            `lead_s`.
        rotors: positions (rad) and velocities (rad/s) of the rotors of elastic gears as rows,
            shape (2, joints).
    """

    joints: Records
    lag_factor: float
    cogging_per_rad: float
    is_elastic: bool
    substep_s: float
    lead_s: float
    rotors: Matrix


def lead_s(integrator: Integrator, substep_s: float) -> float:
    """Return the time after a step's start at which springs act as they do on average over it, s.

    Semi-implicit Euler moves by the new velocity: with springs as they are at the start, it
    conserves energy. Runge-Kutta under a constant torque moves as that torque demands: with springs
    as they are in mid-step, the step is drift-kick-drift (leapfrog), which conserves energy too;
    with springs of its start it would add energy at ω² h / 4 per second. See Hairer, Lubich,
    Wanner, "Geometric Numerical Integration", section I.1.4.
    """
    return 0.5 * substep_s if integrator == "runge_kutta_4" else 0.0


def drive_trains(
    configuration: ActuatorConfiguration, robot: RobotDescription, substep_s: float,
    integrator: Integrator = "semi_implicit_euler",
) -> DriveTrains:  # fmt: skip
    """Return the motors and gears of section ``plant.actuator``, with the rotors at 0.

    Raises:
        ConfigurationError: a value does not fit the arm.
    """
    given, joints = configuration, robot.joints

    def column(name: str, otherwise: float | Vector) -> Vector:
        value = getattr(given, name)
        value = np.broadcast_to(otherwise, (joints,)) if value is None else value
        return expand(value, joints, f"{_KEY}.{name}")

    no_load = column("no_load_speed_rad_s", np.inf)
    rated = column("rated_speed_rad_s", 0.5 * no_load)
    if (rated >= no_load).any() and given.no_load_speed_rad_s is not None:
        allowed = f"must be below no_load_speed_rad_s, {no_load.tolist()}"
        raise ConfigurationError(f"{_KEY}.rated_speed_rad_s", rated.tolist(), allowed)
    rotor, is_elastic = given.rotor_inertia(joints), given.gear_stiffness_nm_rad is not None
    if is_elastic and not rotor.all():
        allowed = "must be above 0 for all joints if gear_stiffness_nm_rad is given"
        raise ConfigurationError(f"{_KEY}.rotor_inertia_kg_m2", rotor.tolist(), allowed)
    columns = {
        "saturation_nm": column("saturation_nm", robot.effort_limits_nm),
        "rated_speed_rad_s": rated,
        "no_load_speed_rad_s": no_load,
        "cogging_nm": column("cogging_nm", 0.0),
        "stiffness_nm_rad": column("gear_stiffness_nm_rad", 0.0),
        "damping_nm_s": column("gear_damping_nm_s", 0.0),
        "rotor_kg_m2": rotor,
    }
    return DriveTrains(
        records(joints, columns),
        math.exp(-substep_s / given.lag_s) if given.lag_s > 0.0 else 0.0,
        given.cogging_periods if given.cogging_nm.any() else 0.0,
        is_elastic, substep_s, lead_s(integrator, substep_s), np.zeros((2, joints)),
    )  # fmt: skip


def place_rotors(trains: DriveTrains, position: Vector, load_nm: Vector) -> None:
    """Turn the rotors so that elastic gears carry a load at rest, N m, shape (joints,)."""
    if trains.is_elastic:
        trains.rotors[0] = position + load_nm / trains.joints["stiffness_nm_rad"]
        trains.rotors[1] = 0.0


@compiled
def largest_torque(trains: DriveTrains, joint: int, torque: float, velocity: float) -> float:
    """Return a motor's largest torque at a speed, N m: less when it accelerates a fast motion."""
    train = trains.joints[joint]
    largest: float = train.saturation_nm
    if torque * velocity > 0.0 and abs(velocity) > train.rated_speed_rad_s:
        left = train.no_load_speed_rad_s - abs(velocity)
        largest *= max(0.0, left / (train.no_load_speed_rad_s - train.rated_speed_rad_s))
    return largest


@compiled
def cogging_torque(trains: DriveTrains, motors: Matrix, joint: int) -> float:
    """Return the torque by which a rotor is pulled to its poles, opposing, N m.

    Args:
        trains: motors and gears.
        motors: positions and velocities of the rotors as rows, shape (2, joints).
        joint: its number.
    """
    angle = motors[0, joint] + trains.lead_s * motors[1, joint]
    return float(trains.joints[joint].cogging_nm * math.sin(trains.cogging_per_rad * angle))


@compiled
def turn_rotor(trains: DriveTrains, motion: Matrix, joint: int, torque: float) -> float:
    """Move the rotor of an elastic gear by a substep; return the gear's torque on the link, N m.

    Args:
        trains: motors and gears.
        motion: positions and velocities of the links as rows, shape (2, joints).
        joint: its number.
        torque: torque on the rotor except the gear's, N m.
    """
    train, rotors = trains.joints[joint], trains.rotors
    twist, rate = rotors[0, joint] - motion[0, joint], rotors[1, joint] - motion[1, joint]
    twist += trains.lead_s * rate
    gear: float = train.stiffness_nm_rad * twist + train.damping_nm_s * rate
    faster = trains.substep_s * (torque - gear) / train.rotor_kg_m2
    rotors[1, joint] += faster
    rotors[0, joint] += trains.substep_s * rotors[1, joint] - trains.lead_s * faster
    return gear


def friction_table(configuration: FrictionConfiguration, rated_nm: Vector) -> Records:
    """Return friction parameters, named as in section ``plant.friction``, shape (joints,).

    Shares of rated torque are added to the parameters in N m.

    Args:
        configuration: the section.
        rated_nm: rated torques, shape (joints,); inf where they are unknown.

    Raises:
        ConfigurationError: a value does not fit the arm.
    """
    joints = rated_nm.size
    columns = {
        name: expand(getattr(configuration, name), joints, f"plant.friction.{name}")
        for name in FrictionConfiguration.model_fields
        if name != "enabled"
    }
    for share, torque in (("coulomb_share", "coulomb_nm"), ("viscous_share_s", "viscous_nm_s")):
        part = columns.pop(share)
        if (part[np.isinf(rated_nm)] > 0.0).any():
            allowed = "must be 0 for joints without a largest torque in the URDF or saturation_nm"
            raise ConfigurationError(f"plant.friction.{share}", part.tolist(), allowed)
        columns[torque] = columns[torque] + part * np.where(part > 0.0, rated_nm, 0.0)
    if not configuration.enabled:
        dry = ("coulomb_nm", "viscous_nm_s", "stribeck_nm", "load_share")
        columns |= dict.fromkeys(dry, np.zeros(joints))
    return records(joints, columns)


@compiled
def friction_torque(
    velocity: float, parameters: Records, joint: int, load_nm: float = 0.0
) -> float:
    """Return the friction torque on one joint whose gear transmits a load, N m."""
    p = parameters[joint]
    stribeck = velocity / p.stribeck_velocity_rad_s
    dry = p.coulomb_nm + p.stribeck_nm * math.exp(-stribeck * stribeck)
    dry += p.load_share * abs(load_nm)
    smooth_sign = math.tanh(velocity / p.smoothing_velocity_rad_s)
    return float(dry * smooth_sign + p.viscous_nm_s * velocity)

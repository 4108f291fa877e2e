"""Implausible values of an arm and its drives, and arms that cannot hold themselves up."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.robot_description import RobotDescription
from controller.manipulator_model import ManipulatorModel, spread_positions

_PLACEHOLDER = 15.0
"""Above this multiple of what gravity and inertia need, a largest torque is a placeholder. The
multiple is 2 to 6 for industrial arms and at most 12 for small ones."""
USUAL_RAD_S2 = 10.0
_EVERY_INERTIA = 10
"""Every so many of the postures give inertias."""
_DAMPING_SHARE = 0.3
_SLOW_RAD_S = 1.0
"""Speed at which friction is judged where a joint has no largest speed."""
_SHOWN, _LISTED = 4, 8


class Loads(NamedTuple):
    """Largest loads of each joint over postures that are spread over the ranges; shape (joints,).

    Attributes:
        gravity_nm: torque that holds the arm up.
        postures_rad: where that is, shape (joints, joints), a posture each.
        inertia_kg_m2: diagonal of the mass matrix.
    """

    gravity_nm: Vector
    postures_rad: Matrix
    inertia_kg_m2: Vector


def loads_of(robot: RobotDescription) -> Loads:
    """Return the largest loads of an arm's joints, without rotors."""
    model, postures = ManipulatorModel(robot), spread_positions(robot)
    gravity = np.abs([model.gravity(each) for each in postures])
    inertia = [np.diagonal(model.mass_matrix(each)) for each in postures[::_EVERY_INERTIA]]
    return Loads(gravity.max(axis=0), postures[gravity.argmax(axis=0)], np.max(inertia, axis=0))


def placeholders(robot: RobotDescription, loads: Loads, torques_nm: Vector) -> Vector:
    """Return the multiples of what the arm needs for torques that no motor of it has, else zero.

    Args:
        robot: the arm.
        loads: of its joints.
        torques_nm: largest torques, shape (joints,).
    """
    slides = np.array(robot.slides)
    needed = np.maximum(loads.gravity_nm, USUAL_RAD_S2 * loads.inertia_kg_m2)
    most = np.array([needed[slides == each].max() for each in slides])
    ratio = np.where(np.isfinite(torques_nm), torques_nm, 0.0) / np.maximum(most, 1e-9)
    return np.where(ratio > _PLACEHOLDER, ratio, 0.0)


def placeholder_warnings(robot: RobotDescription, torques_nm: Vector) -> list[str]:
    """Return a warning about largest torques far above what the arm needs; see `placeholders`."""
    ratios = placeholders(robot, loads_of(robot), torques_nm)
    named = _named(robot, ratios > 0.0, [f"{each:g}" for each in torques_nm])
    more = f"up to {ratios.max():.3g} times what gravity or inertia needs of any joint, so probably"
    advice = "a placeholder. First scenarios estimate it; limits.torque_nm sets it"
    return [f"largest torque of {named}: {more} {advice}"] if named else []


def weak_joint_warnings(robot: RobotDescription) -> list[str]:
    """Return a warning about largest torques that are less than gravity needs in some posture."""
    (needed, postures, _), most = loads_of(robot), robot.effort_limits_nm
    texts = [f"{own:g} of {least:.4g}" for own, least in zip(most, needed, strict=True)]
    named = _named(robot, needed > most, texts)
    worst = int((needed / most).argmax())
    posture = ", ".join(f"{each:.3g}" for each in postures[worst][:_LISTED])
    where = f"{robot.joint_names[worst]} at the joint positions {posture}"
    where += ", …" * (robot.joints > _LISTED)
    return [f"largest torque less than gravity needs: {named}; {where}"] if named else []


def damping_warnings(robot: RobotDescription, viscous: Vector, torques_nm: Vector) -> list[str]:
    """Return a warning about viscous friction that takes much of the torque at top speed.

    Args:
        robot: the arm.
        viscous: viscous friction, shape (joints,), N m s/rad.
        torques_nm: largest torques, shape (joints,).
    """
    limits = robot.velocity_limits_rad_s
    speeds = np.where(np.isfinite(limits), limits, _SLOW_RAD_S)
    shares = viscous * speeds / np.where(torques_nm > 0.0, torques_nm, np.inf)
    numbers = zip(viscous, 100.0 * shares, speeds, strict=True)
    texts = ["{:g} N m s/rad, {:.0f} % at {:g} rad/s".format(*each) for each in numbers]
    named = _named(robot, shares > _DAMPING_SHARE, texts)
    why = "files for simulation have damping that no motor has; plant.friction.viscous_nm_s sets it"
    return [f"damping takes much of the largest torque: {named}; {why}"] if named else []


def _named(robot: RobotDescription, chosen: Iterable[bool], texts: Iterable[str]) -> str:
    """Return the names of some joints, with a text for each."""
    rows = zip(robot.joint_names, chosen, texts, strict=True)
    named = [f"{name} ({text})" for name, is_chosen, text in rows if is_chosen]
    return ", ".join(named[:_SHOWN]) + f" and {len(named) - _SHOWN} more" * (len(named) > _SHOWN)

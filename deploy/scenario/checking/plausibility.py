"""Implausible values of an arm and its drives, and arms that cannot hold themselves up."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.robot_description import RobotDescription
from bus_schema.urdf.arm_sizes import arm_sizes
from controller.manipulator_model import ManipulatorModel, spread_positions

_PLACEHOLDER = 15.0
"""Above this multiple of what gravity and inertia need, a largest torque is a placeholder. The
multiple is 2 to 6 for industrial arms and at most 12 for small ones."""
MOST_NM_PER_KG, _ALIKE_NM_PER_KG = 50.0, 35.0
"""Largest torque for each kg of what a joint moves and of the two links before; and of one that all
joints have. It is 1 to 28 in the files of 120 arms with the torques of their motors."""
_FEWEST_ALIKE = 4
_LEAST_KG_M3, _MOST_KG_M3 = 3.0, 150.0
"""Moved mass by reach cubed: 3.2 (Kinova Jaco) to 128 (ABB IRB 120) of real arms."""
_ROTOR_SHARE = 2.0
"""Largest inertia of a rotor, as a share of the mass of the arm at the end of its reach."""
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


class Placeholders(NamedTuple):
    """Largest torques that no motor of an arm has; shape (joints,).

    Attributes:
        multiples: of what gravity or inertia needs of any joint, where that is too much, else zero.
        nm_per_kg: torque for each kg of links around the motor, where that is too much, else zero.
        is_one: whether the torque of each joint is a placeholder.
    """

    multiples: Vector
    nm_per_kg: Vector
    is_one: NDArray[np.bool_]


def placeholders(robot: RobotDescription, loads: Loads, torques_nm: Vector) -> Placeholders:
    """Return which largest torques no motor of an arm has.

    A torque that is too much for the mass of the links at a wrist is a template in the other joints
    that have the same one.

    Args:
        robot: the arm.
        loads: of its joints.
        torques_nm: largest torques, shape (joints,).
    """
    slides = np.array(robot.slides)
    known = np.where(np.isfinite(torques_nm), torques_nm, 0.0)
    needed = np.maximum(loads.gravity_nm, USUAL_RAD_S2 * loads.inertia_kg_m2)
    most = np.array([needed[slides == each].max() for each in slides])
    ratio = known / np.maximum(most, 1e-9)
    per_kg = np.where(slides, 0.0, known / np.maximum(motor_kg(robot), 1e-9))
    alike = {*known[~slides]}
    is_alike = len(alike) == 1 and (~slides).sum() >= _FEWEST_ALIKE
    dense = per_kg > (_ALIKE_NM_PER_KG if is_alike else MOST_NM_PER_KG)
    templates = np.isin(known, known[dense]) & ~slides
    multiples = np.where(ratio > _PLACEHOLDER, ratio, 0.0)
    return Placeholders(multiples, np.where(dense, per_kg, 0.0), (multiples > 0.0) | templates)


def motor_kg(robot: RobotDescription) -> Vector:
    """Return the mass of the links around each joint's motor, kg; inf where it is not known."""
    if robot.estimated:
        return np.full(robot.joints, np.inf)
    return arm_sizes(robot.text, robot.joint_names).motor_kg


def placeholder_warnings(robot: RobotDescription, torques_nm: Vector) -> list[str]:
    """Return warnings about largest torques far above what the arm needs; see `placeholders`."""
    found = placeholders(robot, loads_of(robot), torques_nm)
    texts = [f"{each:g}" for each in torques_nm]
    advice = "a placeholder. First scenarios estimate it; limits.torque_nm sets it"
    sentences = []
    if named := _named(robot, found.multiples > 0.0, texts):
        more = f"up to {found.multiples.max():.3g} times what gravity or inertia needs of any joint"
        sentences.append(f"largest torque of {named}: {more}, so probably {advice}")
    if named := _named(robot, found.is_one & (found.multiples == 0.0), texts):
        dense = f"up to {found.nm_per_kg.max():.3g} N m for each kg of the links around a wrist"
        real = "where real arms have 1 to 28, so probably"
        sentences.append(f"largest torque of {named}: {dense}, {real} {advice}")
    return sentences


def heavy_rotors(robot: RobotDescription) -> NDArray[np.bool_]:
    """Return which rotors of an arm's file have more inertia than the whole arm stretched out."""
    sizes = arm_sizes(robot.text, robot.joint_names)
    stretched = sizes.moved_kg * sizes.reach_m**2
    is_heavy = robot.drives.rotor_inertia_kg_m2 > _ROTOR_SHARE * max(stretched, 1e-12)
    return is_heavy & ~np.array(robot.slides)


def rotor_warnings(robot: RobotDescription) -> list[str]:
    """Return a warning about rotors that `heavy_rotors` finds."""
    sizes = arm_sizes(robot.text, robot.joint_names)
    texts = [f"{each:g} kg m²" for each in robot.drives.rotor_inertia_kg_m2]
    named = _named(robot, heavy_rotors(robot), texts)
    arm = f"the whole arm of {sizes.moved_kg:.3g} kg, stretched out over {sizes.reach_m:.3g} m"
    advice = "First scenarios estimate it; plant.actuator.rotor_inertia_kg_m2 sets it"
    return [f"rotor inertia of {named}: more than {arm}, has. {advice}"] if named else []


def size_warnings(robot: RobotDescription) -> list[str]:
    """Return a warning about a mass that no real arm of this reach has."""
    sizes = arm_sizes(robot.text, robot.joint_names)
    is_judged = robot.joints >= _FEWEST_ALIKE and sizes.chains == 1 and sizes.reach_m > 0.0
    if not is_judged or robot.estimated or any(robot.slides):
        return []
    density = sizes.moved_kg / sizes.reach_m**3
    if _LEAST_KG_M3 <= density <= _MOST_KG_M3:
        return []
    least, most = (each * sizes.reach_m**3 for each in (_LEAST_KG_M3, _MOST_KG_M3))
    what = f"{sizes.moved_kg:.3g} kg move at a reach of {sizes.reach_m:.3g} m"
    return [f"{what}, where real arms have {least:.2g} to {most:.3g} kg: check masses and lengths"]


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

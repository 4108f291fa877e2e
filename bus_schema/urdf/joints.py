"""Roles of a URDF's joints: driven by a motor, following another joint, or held fixed."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

from bus_schema.errors import JointNameError, RobotDescriptionError, did_you_mean
from bus_schema.urdf.checks import MOVING_TYPES, finite_number, joint_ends, shortened


@dataclass(frozen=True)
class HeldJoint:
    """A joint that is held fixed, and why."""

    name: str
    kind: str
    reason: str


@dataclass(frozen=True)
class Follower:
    """A mimic joint: its position is multiplier × the leader's + offset (rad or m)."""

    name: str
    leader: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class JointRoles:
    """Roles of all joints of a robot except fixed ones, in the order of the file."""

    driven: tuple[str, ...]
    followers: tuple[Follower, ...]
    held: tuple[HeldJoint, ...]


def joint_roles(root: ET.Element, wanted: Sequence[str] | None) -> JointRoles:
    """Return the roles of all joints.

    Args:
        root: the URDF, which passed `check_urdf`.
        wanted: names of the joints to drive; None for all movable joints, except the fingers of
            grippers: joints that slide beside others on the same link.

    Raises:
        RobotDescriptionError: there is none to drive.
        JointNameError: no joint that can be driven has this name.
    """
    joints = {joint.get("name", ""): joint for joint in root.findall("joint")}
    moving = {name: j for name, j in joints.items() if j.get("type") in MOVING_TYPES}
    mimics = {
        name: _follower(joint, element)
        for name, joint in moving.items()
        if (element := joint.find("mimic")) is not None
    }
    if wanted is not None:
        _check_wanted(wanted, [name for name in moving if name not in mimics])
    reasons = _held(joints, mimics, wanted)
    driven = tuple(name for name in moving if name not in mimics and name not in reasons)
    followers = []
    for mimic in mimics.values():
        first = _first_leader(mimic, mimics, moving)
        if first.leader in driven:
            followers.append(first)
        else:
            reasons[mimic.name] = f"mimics {first.leader}, which is held"
    if not driven:
        held_joints = ", ".join(f"{name} is held: {why}" for name, why in reasons.items())
        raise RobotDescriptionError(f"has no joint to drive; {shortened(held_joints)}")
    held = tuple(
        HeldJoint(name, joint.get("type", ""), reasons[name])
        for name, joint in joints.items()
        if name in reasons
    )
    return JointRoles(driven, tuple(followers), held)


def _held(
    joints: dict[str, ET.Element], mimics: dict[str, Follower], wanted: Sequence[str] | None
) -> dict[str, str]:
    """Return the reasons to hold joints that mimic no other, by name."""
    beside = Counter(joint_ends(j)[0] for j in joints.values() if j.get("type") in MOVING_TYPES)
    reasons = {}
    for name, joint in joints.items():
        kind = joint.get("type", "")
        if kind == "fixed" or name in mimics:
            continue
        if kind not in MOVING_TYPES:
            reasons[name] = f"{kind} joints have no motor"
        elif wanted is not None and name not in wanted:
            reasons[name] = "not among robot.joints"
        elif wanted is None and kind == "prismatic" and beside[joint_ends(joint)[0]] > 1:
            reasons[name] = (
                "a gripper's finger: slides beside another joint (robot.joints may drive it)"
            )
    return reasons


def _check_wanted(wanted: Sequence[str], possible: list[str]) -> None:
    for name in wanted:
        if name not in possible:
            allowed = f"robot.joints must be some of {shortened(', '.join(possible)) or 'none'}"
            hint = did_you_mean(name, possible)
            raise JointNameError(f"{allowed}; not {shortened(name)!r}{hint}")


def _follower(joint: ET.Element, mimic: ET.Element) -> Follower:
    name = joint.get("name", "")
    owner = f"mimic of joint {name}"
    return Follower(
        name,
        mimic.get("joint", ""),
        finite_number(owner, "multiplier", mimic.get("multiplier", "1")),
        finite_number(owner, "offset", mimic.get("offset", "0")),
    )


def _first_leader(
    mimic: Follower, mimics: dict[str, Follower], moving: dict[str, ET.Element]
) -> Follower:
    """Return the joint as a follower of the first leader that follows no other."""
    found = mimic
    for _ in range(len(mimics) + 1):
        if found.leader not in moving:
            what = f"mimic of joint {mimic.name} names {shortened(found.leader)!r}"
            raise RobotDescriptionError(f"{what}: must be a joint that turns or slides")
        if found.leader not in mimics:
            return found
        leader = mimics[found.leader]
        found = replace(
            found,
            leader=leader.leader,
            multiplier=found.multiplier * leader.multiplier,
            offset=found.multiplier * leader.offset + found.offset,
        )
    raise RobotDescriptionError(f"the mimics of joint {mimic.name} form a circle")

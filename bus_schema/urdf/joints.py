"""Roles of a URDF's joints: driven by a motor, following another joint, or held fixed."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

from bus_schema.errors import JointNameError, RobotDescriptionError, did_you_mean
from bus_schema.foreign_text import quoted, shortened
from bus_schema.urdf.checks import MOVING_TYPES, finite_number
from bus_schema.urdf.end_effectors import SLIDE, no_arm_joints, sliding_fingers

_SHOWN = 8


@dataclass(frozen=True)
class HeldJoint:
    """A joint that is held fixed, why, and at which position (rad or m)."""

    name: str
    kind: str
    reason: str
    position: float = 0.0


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


def joint_roles(
    root: ET.Element,
    wanted: Sequence[str] | None,
    hold_grippers: bool = False,
    hold: Mapping[str, float] = MappingProxyType({}),
) -> JointRoles:
    """Return the roles of all joints.

    Args:
        root: the URDF, which passed `check_urdf`.
        wanted: names of the joints to drive; None for all movable joints, except the fingers of
            grippers: joints that slide beside others on the same link.
        hold_grippers: also hold the joints of grippers and hands, and of wheels, legs and heads.
        hold: positions of joints to hold, by name; others are held at zero.

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
    own = [name for name in moving if name not in mimics]
    if wanted is not None:
        _check_wanted("robot.joints", wanted, own)
    _check_wanted("robot.hold", hold, [name for name in own if name not in (wanted or ())])
    reasons = _held(joints, mimics, wanted)
    reasons |= {name: _held_at(moving[name], at) for name, at in hold.items()}
    positions = dict(hold)
    driven = tuple(name for name in moving if name not in mimics and name not in reasons)
    if wanted is None and hold_grippers:
        reasons |= no_arm_joints(root, driven, {each.name: each.leader for each in mimics.values()})
        driven = tuple(name for name in driven if name not in reasons)
    followers = []
    for mimic in mimics.values():
        first = _first_leader(mimic, mimics, moving)
        if first is None:
            reasons[mimic.name] = f"mimics {shortened(mimic.leader)}, which does not move"
        elif first.leader in driven:
            followers.append(first)
        else:
            reasons[mimic.name] = f"mimics {first.leader}, which is held"
            at = first.multiplier * positions.get(first.leader, 0.0) + first.offset
            positions[mimic.name] = at
    if not driven:
        raise RobotDescriptionError(f"has no joint to drive: {_all_held(reasons)}")
    held = tuple(
        HeldJoint(name, joint.get("type", ""), reasons[name], positions.get(name, 0.0))
        for name, joint in joints.items()
        if name in reasons
    )
    return JointRoles(driven, tuple(followers), held)


def drop_empty_ranges(root: ET.Element) -> list[str]:
    """Drop ranges of 0 … 0 if no joint has another: exporters write them for unknown ones.

    Returns:
        A warning, if there are such.
    """
    joints = [joint for joint in root.findall("joint") if joint.get("type") in MOVING_TYPES[::2]]
    if not joints or not all(_stands(joint) for joint in joints):
        return []
    for joint in joints:
        for limit in joint.findall("limit"):
            limit.attrib = {k: v for k, v in limit.attrib.items() if k not in ("lower", "upper")}
    return ["all joints have a range of 0 … 0, which is taken as unknown: they move without end"]


def _stands(joint: ET.Element) -> bool:
    """Whether a joint's range is 0 … 0."""
    limit = joint.find("limit")
    if limit is None or "lower" not in limit.attrib or "upper" not in limit.attrib:
        return False
    return all(float(limit.attrib[end]) == 0.0 for end in ("lower", "upper"))


def _held(
    joints: dict[str, ET.Element], mimics: dict[str, Follower], wanted: Sequence[str] | None
) -> dict[str, str]:
    """Return the reasons to hold joints that mimic no other, by name."""
    reasons, fingers = {}, sliding_fingers(joints, mimics)
    for name, joint in joints.items():
        kind = joint.get("type", "")
        if kind == "fixed" or name in mimics:
            continue
        if kind not in MOVING_TYPES:
            reasons[name] = f"{kind} joints have no motor"
        elif wanted is not None and name not in wanted:
            reasons[name] = "not among robot.joints"
        elif wanted is None and kind != "continuous" and _stands(joint):
            reasons[name] = "its range is 0 … 0"
        elif wanted is None and name in fingers:
            reasons[name] = SLIDE
    return reasons


def _all_held(reasons: Mapping[str, str]) -> str:
    """Describe why all joints are held, and how to drive some."""
    groups = {why: [name for name in reasons if reasons[name] == why] for why in reasons.values()}
    parts = [
        f"{', '.join(names[:_SHOWN])}{' and others' * (len(names) > _SHOWN)}: {why.split(' (')[0]}"
        for why, names in groups.items()
    ]
    return f"{'; '.join(parts)}. --joints NAME,… (robot.joints) drives those that it names"


def _held_at(joint: ET.Element, position: float) -> str:
    """Return why a joint is held at a position.

    Raises:
        RobotDescriptionError: its range does not contain it.
    """
    limit, name = joint.find("limit"), joint.get("name", "")
    if limit is not None and joint.get("type") != "continuous":
        low, high = (
            float(limit.get(end, sign + "inf")) for end, sign in (("lower", "-"), ("upper", ""))
        )
        if not low <= position <= high:
            raise RobotDescriptionError(
                f"robot.hold: {name}: {position:g}: must be {low:g} to {high:g}, the joint's range"
            )
    return "robot.hold"


def _check_wanted(key: str, wanted: Iterable[str], possible: list[str]) -> None:
    for name in wanted:
        if name not in possible:
            allowed = f"{key} must be some of {shortened(', '.join(possible)) or 'none'}"
            hint = did_you_mean(name, possible)
            raise JointNameError(f"{allowed}; not {quoted(name)}{hint}")


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
) -> Follower | None:
    """Return the joint as a follower of the first leader that follows no other; None if none."""
    found = mimic
    for _ in range(len(mimics) + 1):
        if found.leader not in moving:
            return None
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

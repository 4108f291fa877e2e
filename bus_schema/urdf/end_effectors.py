"""Joints of a robot that are not its arm's: those of grippers and hands, wheels and heads.

What carries an arm is part of it, such as a lift or a torso. What moves a small share of the mass
and carries nothing is an end effector behind an arm, and a wheel or a head beside one. Names do not
matter.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from bus_schema.urdf.chains import Chain, chains_of
from bus_schema.urdf.checks import MOVING_TYPES, joint_ends, mass_of
from bus_schema.urdf.link_tree import LinkTree

MAY = "(robot.joints may drive it)"
SLIDE = f"a gripper's finger: slides beside another joint {MAY}"
_MIMICKED = f"a gripper's: others mimic it {MAY}"
_BESIDE_FINGERS = f"a gripper's: moves little, on the body that carries its fingers {MAY}"
_SAME_AXIS = f"a gripper's: moves little, about the axis of the joint before it {MAY}"
_OF_HAND = f"of a hand: branches off behind the arm, and is short and light {MAY}"
_JAW = f"a gripper's jaw: last, light, and opens to one side {MAY}"
BESIDE = f"beside the arm, such as a wheel, a leg or a head {MAY}"
OF_GRIPPERS = (_MIMICKED, _BESIDE_FINGERS, _SAME_AXIS, _OF_HAND, _JAW, BESIDE)
"""Reasons to hold a joint that could be driven."""
_CARRIES_A_HAND = 4
"""So many joints in a row are an arm, which may carry a hand."""
_LIGHT, _LITTLE = 0.3, 0.1
"""Largest mass of all fingers, and of what one joint moves, as a share of the arm's."""
_SHORT, _SHORT_BESIDE = 0.3, 0.5
"""Longest finger, as a share of the arm's reach; and longest branch beside an arm of few joints."""
_ONE_SIDED, _WIDEST_RAD, _WIDEST_M = 0.15, 2.5, 0.2
"""Largest turn of a jaw to the other side, as a share of its range; and its widest range."""
_PARALLEL, _SAME_LINE_M = 0.999, 1e-3
"""Least cosine between axes on one line, and their largest distance."""


def sliding_fingers(joints: Mapping[str, ET.Element], mimics: Collection[str]) -> list[str]:
    """Return the joints that slide beside others on the same link, and carry no other joint.

    Args:
        joints: all joints by name.
        mimics: those that follow others, which a finger may carry.
    """
    moving = {name: j for name, j in joints.items() if j.get("type") in MOVING_TYPES}
    ends = {name: joint_ends(joint) for name, joint in joints.items()}
    carriers = {child: parent for parent, child in ends.values()}
    carrying = set()
    for name in moving.keys() - set(mimics):
        link = ends[name][0]
        while link in carriers and link not in carrying:
            carrying.add(link)
            link = carriers[link]
    parents = [ends[name][0] for name in moving]
    return [
        name
        for name, joint in moving.items()
        if joint.get("type") == "prismatic"
        and parents.count(ends[name][0]) > 1
        and ends[name][1] not in carrying
    ]


def no_arm_joints(
    root: ET.Element, driven: Sequence[str], leaders: Mapping[str, str]
) -> dict[str, str]:
    """Return which of some joints are no arm's, and why; none if that would be all of them.

    Args:
        root: the URDF, which passed `check_urdf`.
        driven: names of the joints that could be driven.
        leaders: the joint that each mimic joint follows, by name.
    """
    found = dict.fromkeys(_mimicked(root, driven, leaders), _MIMICKED)
    found |= _hands(_Parts(root, [name for name in driven if name not in found]))
    rest = [name for name in driven if name not in found]
    found |= dict.fromkeys(_beside_arms(root, rest), BESIDE)
    return found if found.keys() < set(driven) else {}


class _Parts:
    """Links that the joints of a robot move.

    Args:
        root: the URDF.
        names: names of the joints.

    Attributes:
        tree: its links.
        links: the link that each joint carries.
        above: the joints above each one, the next one first.
    """

    def __init__(self, root: ET.Element, names: Sequence[str]) -> None:
        self.tree = LinkTree(root)
        carried = {joint.get("name", ""): link for link, joint in self.tree.joints.items()}
        self.links = {name: carried[name] for name in names}
        ways = {name: [j.get("name", "") for j in self.tree.above(carried[name])] for name in names}
        self.above = {name: [each for each in ways[name][1:] if each in ways] for name in names}
        self._all = {j.get("name", "") for j in root.findall("joint") if j.get("type") != "fixed"}

    def behind(self, name: str) -> set[str]:
        """Return the joints that a joint carries."""
        return {each for each, above in self.above.items() if name in above}

    def moved_kg(self, names: set[str]) -> float:
        """Return the mass that some joints move."""
        links = self.tree.links.items()
        return sum(mass_of(link) for name, link in links if self.tree.mover(name, names))

    def share(self, name: str) -> float:
        """Return the mass that a joint moves, as a share of its arm's."""
        whole = self.moved_kg({self.above[name][-1]})
        return self.moved_kg({name}) / max(whole, 1e-12)

    def body(self, name: str) -> str | None:
        """Return the joint of any kind that moves the body which carries a joint."""
        return self.tree.mover(joint_ends(self.tree.joints[self.links[name]])[0], self._all)

    def carries_followers(self, name: str) -> bool:
        """Whether a joint's body also carries a joint that is not among these."""
        return any(
            self.tree.mover(joint_ends(joint)[0], self._all) == self.body(name)
            for joint in self.tree.joints.values()
            if joint.get("name") in self._all and joint.get("name") not in self.links
        )

    def is_coaxial(self, name: str) -> bool:
        """Whether a joint turns about the same line as the next one above it."""
        ends = [self.tree.joints[self.links[each]] for each in (name, self.above[name][0])]
        if not all(each.get("type") in MOVING_TYPES[:2] for each in ends):
            return False
        (at, axis), (other, along) = map(self.tree.axis, ends)
        lever = np.cross(at - other, along)
        is_parallel = abs(float((axis * along).sum())) > _PARALLEL
        return is_parallel and float(np.sqrt((lever**2).sum())) < _SAME_LINE_M

    def reach_m(self, first: str, last: str | None = None) -> float:
        """Return the length of the way from a joint to another, or to the farthest link."""
        tree, start = self.tree, self.links[first]
        ends = [self.links[last]] if last else [k for k in tree.links if tree.mover(k, {first})]
        return max(self._way_m(end) for end in ends) - self._way_m(start)

    def _way_m(self, link: str) -> float:
        places = [self.tree.frame(joint_ends(each)[1])[0] for each in self.tree.above(link)]
        steps = np.diff(np.array(places), axis=0) if len(places) > 1 else np.zeros((1, 3))
        return float(np.sqrt((steps**2).sum(axis=1)).sum())


def _mimicked(root: ET.Element, driven: Sequence[str], leaders: Mapping[str, str]) -> set[str]:
    """Return joints that others mimic, where neither carries any other joint to drive."""
    tree, found = LinkTree(root), set()
    for leader in set(leaders.values()).intersection(driven):
        group = {leader, *(name for name, followed in leaders.items() if followed == leader)}
        others = [link for link, joint in tree.joints.items() if joint.get("name") in driven]
        carried = [link for link in others if tree.mover(joint_ends(tree.joints[link])[0], group)]
        if not carried:
            found.add(leader)
    return found


def _hands(parts: _Parts) -> dict[str, str]:
    """Return the joints of end effectors behind an arm, and what they are."""
    found = dict[str, str]()
    for name, above in parts.above.items():
        if len(above) >= _CARRIES_A_HAND and name not in found:
            fingers = _fingers(parts, above)
            found |= dict.fromkeys(fingers, _OF_HAND)
            if not fingers and (why := _last_of_gripper(parts, name)):
                found[name] = why
    return found


def _fingers(parts: _Parts, above: Sequence[str]) -> set[str]:
    """Return all joints behind an arm whose last joint carries several, if they are fingers."""
    behind = parts.behind(above[0])
    roots = [each for each in behind if parts.above[each][0] == above[0]]
    if len(roots) < 2:
        return set()
    is_light = parts.moved_kg(behind) <= _LIGHT * parts.moved_kg({above[-1]})
    reach_m = parts.reach_m(above[-1], roots[0])
    is_short = max(parts.reach_m(each) for each in roots) <= _SHORT * reach_m
    return behind if is_light and is_short else set()


def _last_of_gripper(parts: _Parts, name: str) -> str:
    """Return why a joint behind an arm is a gripper's; an empty text for one of the arm."""
    if parts.behind(name) or parts.share(name) > _LITTLE:
        return ""
    if parts.carries_followers(name):
        return _BESIDE_FINGERS
    if parts.is_coaxial(name):
        return _SAME_AXIS
    return _JAW if _opens(parts.tree.joints[parts.links[name]]) else ""


def _opens(joint: ET.Element) -> bool:
    """Whether a joint turns to one side only, or slides little, as a jaw does."""
    limit = joint.find("limit")
    if joint.get("type") == "continuous" or limit is None:
        return False
    low, high = (float(limit.get(end, "inf")) for end in ("lower", "upper"))
    if joint.get("type") == "prismatic":
        return high - low <= _WIDEST_M
    return high - low <= _WIDEST_RAD and min(abs(low), abs(high)) <= _ONE_SIDED * (high - low)


def _beside_arms(root: ET.Element, driven: Sequence[str]) -> list[str]:
    """Return the joints of branches that are no arms, if there is an arm.

    Beside an arm of few joints, such as a lift with a wrist, they are those of short or light
    branches.
    """
    chains = chains_of(root, driven)
    most = max((len(each.joints) for each in chains), default=0)
    if most >= _CARRIES_A_HAND:
        beside = [each for each in chains if len(each.joints) < _CARRIES_A_HAND]
    else:
        arm = max(chains, key=lambda each: each.reach_m * each.mass_kg, default=None)
        beside = [each for each in chains if arm is not None and _is_small(each, arm)]
    return [name for each in beside for name in each.joints]


def _is_small(chain: Chain, arm: Chain) -> bool:
    """Whether a chain is short or light beside an arm."""
    return chain.reach_m < _SHORT_BESIDE * arm.reach_m or chain.mass_kg < _LITTLE * arm.mass_kg

"""Chains of a robot's driven joints, each an arm, a leg or a head."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bus_schema.errors import RobotDescriptionError, did_you_mean
from bus_schema.urdf.checks import mass_of
from bus_schema.urdf.link_tree import LinkTree

_SHOWN = 8
_FEWEST_BESIDE = 3
"""A branch with fewer joints, such as a finger or a head, is no arm beside another one."""


class Chain(NamedTuple):
    """Joints one after the other.

    Attributes:
        tip: the last link.
        joints: names of its driven joints, from the base.
        reach_m: length of the way from its first joint to the tip.
        mass_kg: mass that its joints move.
    """

    tip: str
    joints: tuple[str, ...]
    reach_m: float
    mass_kg: float


def chains_of(root: ET.Element, driven: Sequence[str]) -> list[Chain]:
    """Return the chains of a robot.

    Joints that carry several arms, such as those of a torso, belong to none of them.

    Args:
        root: its URDF, which passed `check_urdf`.
        driven: names of its driven joints.
    """
    tree = LinkTree(root)
    tips: dict[tuple[str, ...], str] = {}  # the last of the links that the same joints move
    for link in tree.joints:
        way = _way(tree, link, driven)
        if len(list(tree.above(link))) >= len(list(tree.above(tips.get(way, "")))):
            tips[way] = link
    ends = [way for way in tips if way and not any(o[: len(way)] == way for o in tips if o != way)]
    return [_chain(tree, tips[end], _own(end, ends)) for end in ends]


def chain_warnings(root: ET.Element, driven: Sequence[str]) -> list[str]:
    """Return a warning about driven joints that are several chains.

    Args:
        root: the URDF of a robot.
        driven: names of its driven joints.
    """
    if len(chains := chains_of(root, driven)) < 2:
        return []
    tips = ", ".join(each.tip for each in chains[:_SHOWN]) + ", …" * (len(chains) > _SHOWN)
    what = "an arm each, or legs, wheels or fingers? They are driven together"
    return [
        f"its driven joints are {len(chains)} chains side by side (tips {tips}), {what};"
        " funnel-hil robot FILE --chain TIP drives one, and --scenario writes it to a file"
    ]


def chosen_joints(root: ET.Element, driven: Sequence[str], name: str) -> list[str]:
    """Return the joints of a chain up to a link, or of the one whose joints' names have a part.

    Args:
        root: the URDF of a robot.
        driven: names of its driven joints.
        name: the link, or the part of the names.

    Raises:
        RobotDescriptionError: there is none.
    """
    tree, chains = LinkTree(root), chains_of(root, driven)
    ways = [set(each.joints).intersection(_way(tree, name, driven)) for each in chains]
    named = [{joint for joint in each.joints if name in joint} for each in chains]
    found = max(ways, key=len, default=set()) or set().union(*named)
    if not found or not any(found <= set(each.joints) for each in chains):
        raise RobotDescriptionError(
            f"--chain {name}: must be a link that driven joints move, such as the tips"
            f" {', '.join(each.tip for each in chains)}, or in the names of joints of one chain"
            f" only{did_you_mean(name, list(tree.links))}"
        )
    return [joint for joint in driven if joint in found]


def _way(tree: LinkTree, link: str, driven: Sequence[str]) -> tuple[str, ...]:
    """Return the driven joints from the base to a link."""
    names = [joint.get("name", "") for joint in tree.above(link)]
    return tuple(name for name in reversed(names) if name in driven)


def _own(end: tuple[str, ...], ends: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    """Return the joints of a chain that carry no other arm."""
    branches = [
        (next(i for i, pair in enumerate(zip(end, other, strict=False)) if len({*pair}) > 1), other)
        for other in ends
        if other != end
    ]
    first = max((at for at, other in branches if len(other) - at >= _FEWEST_BESIDE), default=0)
    return end[first:]


def _chain(tree: LinkTree, tip: str, joints: tuple[str, ...]) -> Chain:
    carried = {id(joint): link for link, joint in tree.joints.items()}
    above = list(tree.above(tip))
    first = next(i for i, joint in enumerate(above) if joint.get("name") == joints[0])
    places = [tree.frame(link)[0] for link in (tip, *(carried[id(j)] for j in above[: first + 1]))]
    steps = np.diff(np.array(places), axis=0)
    moved = [link for name, link in tree.links.items() if tree.mover(name, {*joints})]
    reach_m = float(np.sqrt((steps**2).sum(axis=1)).sum())
    return Chain(tip, joints, reach_m, sum(map(mass_of, moved)))

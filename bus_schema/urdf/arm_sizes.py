"""Sizes of an arm that tell plausible values from others: its mass, reach and neighbours."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.urdf.chains import chains_of
from bus_schema.urdf.checks import joint_ends, mass_of
from bus_schema.urdf.link_tree import LinkTree

_MOTOR_SEAT = 3
"""The motor of a joint is in what it moves, or on one of the two links before."""


class ArmSizes(NamedTuple):
    """Sizes of an arm.

    Attributes:
        carriers: index of the driven joint before each one; -1 for none.
        motor_kg: mass of what each joint moves and of the two links before, where its motor is; inf
            for the first joints, whose motor may be in the base. Shape (joints,).
        moved_kg: mass of all that moves.
        reach_m: longest way from a first joint along the links to the end of the last one.
        chains: number of chains.
    """

    carriers: tuple[int, ...]
    motor_kg: Vector
    moved_kg: float
    reach_m: float
    chains: int


@lru_cache(maxsize=16)
def arm_sizes(text: str, joint_names: tuple[str, ...]) -> ArmSizes:
    """Return the sizes of an arm.

    Args:
        text: its URDF.
        joint_names: its driven joints.
    """
    root = ET.fromstring(text)
    tree, driven = LinkTree(root), {*joint_names}
    links = {joint.get("name", ""): link for link, joint in tree.joints.items()}
    ways = [_ways(tree, links[name], driven) for name in joint_names]
    movers = {link: tree.mover(link, driven) for link in tree.links}
    moved = {link: mass_of(tree.links[link]) for link, mover in movers.items() if mover}
    carriers = [joint_names.index(way[1]) if len(way) > 1 else -1 for way in ways]

    def motor_kg(way: Sequence[str]) -> float:
        if len(way) < _MOTOR_SEAT:
            return math.inf
        before = [kg for link, kg in moved.items() if movers[link] in way[1:_MOTOR_SEAT]]
        behind = [kg for link, kg in moved.items() if tree.mover(link, {way[0]})]
        return sum(before) + sum(behind)

    return ArmSizes(
        tuple(carriers),
        np.array([motor_kg(way) for way in ways]),
        sum(moved.values()),
        max(_reach_m(tree, link, driven) for link in moved),
        len(chains_of(root, joint_names)),
    )


def _ways(tree: LinkTree, link: str, driven: set[str]) -> list[str]:
    """Return the driven joints from a link to the base."""
    return [each for joint in tree.above(link) if (each := joint.get("name", "")) in driven]


def _reach_m(tree: LinkTree, link: str, driven: set[str]) -> float:
    """Return the length of the way from the first driven joint to the end of a link.

    The end is as far beyond the centre of mass as that is from the link's joint.
    """
    length_m, at = 2.0 * _distance(tree, link), tree.frame(link)[0]
    for joint in tree.above(link):
        if not tree.mover(parent := joint_ends(joint)[0], driven):
            break
        before = tree.frame(parent)[0]
        length_m += float(np.sqrt(((at - before) ** 2).sum()))
        at = before
    return length_m


def _distance(tree: LinkTree, link: str) -> float:
    lever = tree.center(link)[0] - tree.frame(link)[0]
    return float(np.sqrt((lever**2).sum()))

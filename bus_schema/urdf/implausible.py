"""Contents of an arm's file that are possible, but that no real arm has."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Collection, Iterator
from itertools import takewhile

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.urdf.checks import joint_ends, mass_of
from bus_schema.urdf.link_tree import LinkTree

_FEWEST = 4
"""Links that may weigh the same by chance are fewer."""
_OUTSIDE = 0.5
"""Distance of a centre of mass from its link, as a share of the arm's extent."""
_PARALLEL = 0.999
"""Least cosine between axes that are one line."""
_NO_FLANGE = re.compile(r"finger|jaw|knuckle|camera|optical|sensor|lidar", re.IGNORECASE)


def mass_warnings(root: ET.Element, moving: set[str]) -> Iterator[str]:
    """Return warnings about masses and their centres.

    Args:
        root: the URDF, which passed `check_urdf`.
        moving: names of the joints that move.
    """
    tree = LinkTree(root)
    moved = [name for name in tree.links if tree.mover(name, moving)]
    heavy = [name for name in moved if mass_of(tree.links[name]) > 0.0]
    masses = {mass_of(tree.links[name]) for name in heavy}
    if len(heavy) >= _FEWEST and len(masses) == 1:
        yield f"all {len(heavy)} moved links have the same mass: {masses.pop():g} kg"
    places = np.array([tree.frame(name)[0] for name in moved])
    extent = float(np.sqrt(((places - places[0]) ** 2).sum(axis=1)).max())
    children = defaultdict[str, list[str]](list)
    for child, joint in tree.joints.items():
        children[joint_ends(joint)[0]].append(child)
    for name in heavy if len(moving) >= _FEWEST else ():
        at = tree.frame(name)[0]
        ends = [tree.frame(child)[0] for child in children[name]]
        length = max((_distance(end, at) for end in ends), default=0.0)
        if (far := _distance(tree.center(name)[0], at)) - length > _OUTSIDE * extent:
            size = f"the link is {length:.3g} m long, and the arm {extent:.3g} m"
            yield f"the centre of mass of link {name} is {far:.3g} m from its frame; {size}"


def telescope_warnings(root: ET.Element, driven: Collection[str]) -> Iterator[str]:
    """Return a warning about driven joints that are the stages of a telescope.

    Args:
        root: the URDF, which passed `check_urdf`.
        driven: names of the driven joints.
    """
    tree, stages = LinkTree(root), dict[str, None]()
    slides = {j.get("name", ""): j for j in tree.joints.values() if j.get("type") == "prismatic"}
    for name in (each for each in slides if each in driven):
        above = (j.get("name", "") for j in tree.above(joint_ends(slides[name])[0]))
        carrier = next((each for each in above if each in driven), "")
        if carrier in slides:
            ways = tree.axis(slides[name])[1], tree.axis(slides[carrier])[1]
            if abs(float((ways[0] * ways[1]).sum())) > _PARALLEL:
                stages |= {carrier: None, name: None}
    if stages:
        what = "slide along one line: stages of a telescope, which one motor moves together"
        yield f"{', '.join(stages)} {what}; each has a motor of its own here"


def tip_warnings(root: ET.Element, tip: str, driven: Collection[str]) -> Iterator[str]:
    """Return a warning if the tip, which carries payloads, is a finger or a camera.

    Args:
        root: the URDF, which passed `check_urdf`.
        tip: the link.
        driven: names of the driven joints.
    """
    tree = LinkTree(root)
    behind = list(takewhile(lambda joint: joint.get("name") not in driven, tree.above(tip)))
    if behind and (any(j.get("type") != "fixed" for j in behind) or _NO_FLANGE.search(tip)):
        flange = joint_ends(behind[-1])[0]
        far = _distance(tree.frame(tip)[0], tree.frame(flange)[0])
        where = f"{far:.3g} m from {flange}, the link behind the last driven joint"
        yield f"the tip, which carries payloads, is {tip}: a finger or sensor {where}"


def _distance(first: Vector, second: Vector) -> float:
    return float(np.sqrt(((first - second) ** 2).sum()))

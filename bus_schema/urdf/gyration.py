"""Moments of inertia that no body of a link's mass and size can have, and estimates instead.

A body extends at least as far from its centre of mass as its radius of gyration, √(I / m). In
templates every link has 1 kg m².
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bus_schema.arrays import Matrix
from bus_schema.urdf.checks import INERTIA, inertia_of, mass_of
from bus_schema.urdf.inertia_estimate import MARK, likely_moments
from bus_schema.urdf.link_tree import LinkTree, tensor_of

_IMPOSSIBLE, _SUSPICIOUS = 1.5, 0.75
"""Radius of gyration of a link, as a share of the extent of the whole arm. It is at most 0.5 in the
files of 120 arms but for templates and rounding; 1.3 of a finger of 0.1 kg, for instance."""
_FEWEST = 3
"""So few joints do not show how large an arm is."""
_SHOWN = 6


def mend_gyration(
    root: ET.Element, base: Path, moving: set[str], include: Sequence[Path], *, repair: bool
) -> list[str]:
    """Replace impossible moments of inertia of moved links, and return warnings.

    Args:
        root: the URDF, which passed `check_urdf`.
        base: its folder.
        moving: names of the joints that move.
        include: folders with packages that the user names.
        repair: also replace those that are only suspicious.
    """
    tree = LinkTree(root)
    shares = _shares(tree, moving) if len(moving) >= _FEWEST else {}
    least = _SUSPICIOUS if repair else _IMPOSSIBLE
    mended = [name for name, share in shares.items() if share > least]
    named = [name for name, share in shares.items() if _SUSPICIOUS < share <= least]
    sentences = [
        f"radius of gyration √(I/m) of {_listed(tree, names)}: more than {share:g} times the arm's"
        f" size, which no body of a link has; {remedy}"
        for names, share, remedy in (
            (mended, least, "these moments of inertia are ESTIMATED from shapes and lengths"),
            (named, _SUSPICIOUS, "--repair (robot.repair: true) estimates them instead"),
        )
        if names
    ]
    for name, tensor in likely_moments(tree, mended, base, moving, include).items():
        _write(tree.links[name], mass_of(tree.links[name]) * tensor)
    return sentences


def _shares(tree: LinkTree, moving: set[str]) -> dict[str, float]:
    """Return the radius of gyration of moved links with mass, as a share of the arm's extent."""
    moved = [
        name for name, link in tree.links.items() if tree.mover(name, moving) and mass_of(link)
    ]
    places = [tree.frame(name)[0] for name in tree.links]
    places += [tree.center(name)[0] for name in moved]
    low, high = np.min(places, axis=0), np.max(places, axis=0)
    extent_m = float(np.sqrt(((high - low) ** 2).sum()))
    if not extent_m:
        return {}
    return {name: _radius_m(tree.links[name]) / extent_m for name in moved}


def _radius_m(link: ET.Element) -> float:
    """Return the largest radius of gyration of a link."""
    largest = max(inertia_of(link)[place] for place in (0, 3, 5))
    return math.sqrt(max(largest, 0.0) / mass_of(link))


def _write(link: ET.Element, tensor: Matrix) -> None:
    """Write moments of inertia in the axes of a link."""
    inertial, inertia = link.find("inertial"), link.find("inertial/inertia")
    assert inertial is not None
    assert inertia is not None
    inertial.set(MARK, "their sizes")
    for origin in inertial.findall("origin"):
        origin.attrib.pop("rpy", None)
    places = zip(INERTIA, np.transpose(np.triu_indices(3)).tolist(), strict=True)
    for name, (row, column) in places:
        inertia.set(name, f"{tensor[row, column]:.6g}")


def _listed(tree: LinkTree, names: Sequence[str]) -> str:
    """Return names of links with their radius, moment and mass."""
    shown = []
    for name in names[:_SHOWN]:
        link = tree.links[name]
        largest = max(tensor_of(link).diagonal())
        shown.append(
            f"{name} ({_radius_m(link):.3g} m: {largest:.3g} kg m² at {mass_of(link):g} kg)"
        )
    return ", ".join(shown) + f" and {len(names) - _SHOWN} more" * (len(names) > _SHOWN)

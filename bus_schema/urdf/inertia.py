"""Inertias of a URDF's links: checks for impossible ones, and the nearest possible ones."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.eigenvalues import eigenvalues
from bus_schema.errors import RobotDescriptionError
from bus_schema.urdf.checks import INERTIA, inertia_of, mass_of
from bus_schema.urdf.link_tree import LinkTree, along, tensor_of

_ROUNDING = 1e-3
_SLIGHT = 0.15
"""Typical errors in real robots' files: few digits, or boxes fitted to meshes."""
_LEAST_KG_M2, _LEAST_SHARE = 2e-14, 1e-12
"""Least principal moment, and its share of the largest: MuJoCo takes no thinner needle."""
_LARGEST_CHANGE = 0.05
"""Of a joint's inertia, by a replacement that the user did not ask for."""


def judge_inertias(root: ET.Element, moving: set[str], *, repair: bool) -> list[str]:
    """Return warnings about inertias that are replaced, or belong to no real body.

    Args:
        root: the URDF, which passed `check_urdf`.
        moving: names of the joints that move; links that no joint moves may have any inertia.
        repair: also accept a replacement that changes the inertia of a joint much.

    Raises:
        RobotDescriptionError: a moving link has one too far from possible ones.
    """
    tree = LinkTree(root)
    moved = {name: link for name, link in tree.links.items() if tree.mover(name, moving)}
    warnings = [each for name in moved if (each := _judged(tree, name, moving, repair=repair))]
    massless = [name for name in moved if not mass_of(moved[name]) and any(inertia_of(moved[name]))]
    if massless:
        warnings.append(
            f"{', '.join(massless)}: inertia without mass, which no rigid body has; it is used as"
            " given"
        )
    return warnings


def mend_inertias(root: ET.Element) -> None:
    """Replace impossible inertias by the nearest possible ones with the same largest moment."""
    for link in root.findall("link"):
        principal = _principal(link)
        is_needle = principal[0] < _least(principal[2]) < principal[2]
        if _excess(principal) > 0.0 or is_needle:  # MuJoCo refuses the last digit of a rounded one
            tensor, element = _mended(tensor_of(link)), link.find("inertial/inertia")
            assert element is not None
            places = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
            for name, place in zip(INERTIA, places, strict=True):
                element.set(name, repr(float(tensor[place])))


def _judged(tree: LinkTree, name: str, moving: set[str], *, repair: bool) -> str:
    """Return a warning if `mend_inertias` will visibly replace a moving link's inertia."""
    principal = _principal(tree.links[name])
    excess = _excess(principal)
    if excess <= _ROUNDING:
        return ""
    change, joint = _largest_change(tree, name, moving)
    effect = f", the inertia of joint {joint} by {100 * change:.2g} %" if change else ""
    if excess > _SLIGHT and change > _LARGEST_CHANGE and not repair:
        raise RobotDescriptionError(
            f"link {name} has principal moments of inertia {principal.tolist()}; none may be"
            " negative or exceed the sum of the others. --repair (robot.repair: true) raises the"
            f" smaller ones as far as necessary{effect}"
        )
    return (
        f"the inertia of link {name} breaks the triangle rule by {100 * excess:.2g} % of its"
        f" largest moment: its smaller moments are raised as far as necessary{effect}"
    )


def _largest_change(tree: LinkTree, name: str, moving: set[str]) -> tuple[float, str]:
    """Return the largest share of a joint's inertia that a link's replacement adds; the joint."""
    own, turn = tensor_of(tree.links[name]), tree.center(name)[1]
    added, changes = _mended(own) - own, [(0.0, "")]
    for joint in tree.above(name):
        if joint.get("name") in moving and joint.get("type") != "prismatic":
            links = [each for each in tree.links if joint in tree.above(each)]
            new = along(added, turn, tree.axis(joint)[1])
            whole = sum(tree.inertia_about(joint, each) for each in links)
            changes.append((abs(new) / max(whole, 1e-12), joint.get("name", "")))
    return max(changes)


def _principal(link: ET.Element) -> Vector:
    """Return a link's principal moments in ascending order, kg m², shape (3,)."""
    return np.sort(eigenvalues(tensor_of(link))[0])


def _mended(tensor: Matrix) -> Matrix:
    moments, axes = eigenvalues(tensor)
    ascending = np.argsort(moments, kind="stable")
    moments, axes = np.maximum(moments[ascending], 0.0), axes[:, ascending]
    if (least := _least(moments[2])) < moments[2]:
        moments = np.maximum(moments, least)
    lacking = moments[2] * (1.0 + 1e-9) - moments[0] - moments[1]
    if lacking > 0.0:
        moments[:2] += lacking / 2
    return np.asarray(((axes * moments)[:, None, :] * axes).sum(axis=2))


def _least(largest: float) -> float:
    """Return the least principal moment beside the largest, kg m²."""
    return max(_LEAST_KG_M2, _LEAST_SHARE * largest)


def _excess(principal: NDArray[np.floating]) -> float:
    """Return how far ascending principal moments violate the rule, as a share of the largest."""
    worst = max(-principal[0], principal[2] - principal[0] - principal[1])
    return float(worst / max(abs(principal[2]), 1e-12))

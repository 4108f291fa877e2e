"""Inertias of a URDF's links: whether a body can have them, and the nearest that one can."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.eigenvalues import eigenvalues
from bus_schema.errors import RobotDescriptionError
from bus_schema.urdf.checks import INERTIA, check_inertial, inertia_of, joint_ends, mass_of

_ROUNDING = 1e-3
_SLIGHT = 0.15
"""What real robots' files get wrong: by rounding to few digits, or fitting boxes to meshes."""


@dataclass(frozen=True)
class OddInertia:
    """An inertia that no body has: a principal moment exceeds the sum of the others.

    Attributes:
        link: whose.
        excess: by how much, as a share of the largest moment.
    """

    link: str
    excess: float


def odd_inertias(root: ET.Element) -> list[OddInertia]:
    """Links whose inertia breaks the triangle rule by more than rounding, or has a negative moment.

    Raises:
        RobotDescriptionError: an inertia or a mass is no number, or a mass is negative.
    """
    found = []
    for link in root.findall("link"):
        if check_inertial(link) is None:
            continue
        principal = _principal_moments(link)
        excess = _excess(principal)
        if excess > _ROUNDING or principal[0] < 0.0:
            found.append(OddInertia(link.get("name", ""), excess))
    return found


def judge_inertias(root: ET.Element, moving: set[str], *, repair: bool) -> list[str]:
    """What to say of inertias that are taken all the same, as `mend_inertias` mends them.

    Args:
        root: the URDF.
        moving: names of the joints that move; what stands still may have any inertia.
        repair: take those too that are far from what a body can have.

    Raises:
        RobotDescriptionError: one is too far off.
    """
    said = []
    still = standing_links(root, moving)
    for odd in odd_inertias(root):
        if odd.link in still:
            continue
        if odd.excess > _SLIGHT and not repair:
            link = next(each for each in root.findall("link") if each.get("name") == odd.link)
            raise RobotDescriptionError(
                f"link {odd.link} has principal moments of inertia"
                f" {_principal_moments(link).tolist()}; none may be negative or exceed the"
                " sum of the others (robot.repair: true raises the smaller ones until they do not)"
            )
        if odd.excess <= _ROUNDING:
            continue
        said.append(
            f"the inertia of link {odd.link} breaks the triangle rule by {100 * odd.excess:.2g} %"
            " of its largest moment: its smaller moments are raised until it does not"
        )
    return said


def massless_inertias(root: ET.Element, moving: set[str]) -> list[str]:
    """Names of moving links with a rotational inertia but no mass."""
    still = standing_links(root, moving)
    return [
        name
        for link in root.findall("link")
        if (name := link.get("name", "")) not in still
        and check_inertial(link) is not None
        and mass_of(link) == 0.0
        and any(inertia_of(link))
    ]


def standing_links(root: ET.Element, moving: set[str]) -> set[str]:
    """Names of the links that no moving joint carries."""
    carriers: dict[str, tuple[str, str]] = {}
    for joint in root.findall("joint"):
        parent, child = joint_ends(joint)
        carriers[child] = (joint.get("name", ""), parent)

    def stands(link: str) -> bool:
        while link in carriers:
            joint, link = carriers[link]
            if joint in moving:
                return False
        return True

    return {name for link in root.findall("link") if stands(name := link.get("name", ""))}


def mend_inertias(root: ET.Element) -> None:
    """Replace inertias that no body has by the nearest ones with the same largest moment."""
    odd = {each.link for each in odd_inertias(root)}
    for link in root.findall("link"):
        if link.get("name") in odd:
            tensor = _mended(_tensor(link))
            element = link.find("inertial/inertia")
            assert element is not None
            places = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
            for name, place in zip(INERTIA, places, strict=True):
                element.set(name, repr(float(tensor[place])))


def _mended(tensor: Matrix) -> Matrix:
    moments, axes = eigenvalues(tensor)
    ascending = np.argsort(moments, kind="stable")
    moments, axes = np.maximum(moments[ascending], 0.0), axes[:, ascending]
    lacking = moments[2] * (1.0 + 1e-9) - moments[0] - moments[1]
    if lacking > 0.0:
        moments[:2] += lacking / 2
    return np.asarray(((axes * moments)[:, None, :] * axes).sum(axis=2))


def _principal_moments(link: ET.Element) -> Vector:
    """In ascending order."""
    return np.sort(eigenvalues(_tensor(link))[0])


def _excess(principal: NDArray[np.floating]) -> float:
    """By how much ascending principal moments break the rule, as a share of the largest."""
    worst = max(-principal[0], principal[2] - principal[0] - principal[1])
    return float(worst / max(abs(principal[2]), 1e-12))


def _tensor(link: ET.Element) -> Matrix:
    xx, xy, xz, yy, yz, zz = inertia_of(link)
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def check_moved_masses(root: ET.Element, moving: set[str]) -> None:
    """Refuse what moves without inertia: no torque would give it a finite acceleration.

    Args:
        root: the URDF.
        moving: names of the joints that move.

    Raises:
        RobotDescriptionError: a link that a joint moves weighs nothing, nor what is fixed to it.
    """
    rigid: dict[str, list[str]] = {}
    moved: list[tuple[str, str]] = []
    for joint in root.findall("joint"):
        parent, child = joint_ends(joint)
        if joint.get("name") in moving:
            moved.append((joint.get("name", ""), child))
        else:
            rigid.setdefault(parent, []).append(child)
    heavy = {
        link.get("name", "")
        for link in root.findall("link")
        if mass_of(link) > 0.0 or any(inertia_of(link))
    }
    for joint_name, link_name in moved:
        body = [link_name]
        for each in body:  # which grows
            body += rigid.get(each, [])
        if heavy.isdisjoint(body):
            raise RobotDescriptionError(
                f"link {link_name}, which joint {joint_name} moves, has no inertia, nor has any"
                " link fixed to it: give it an <inertial> with a mass, make the joint fixed, or"
                " leave it out of robot.joints"
            )

"""Inertias of a URDF's links: checks for impossible ones, and the nearest possible ones."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.eigenvalues import eigenvalues
from bus_schema.errors import RobotDescriptionError
from bus_schema.urdf.checks import INERTIA, inertia_of, joint_ends, mass_of

_ROUNDING = 1e-3
_SLIGHT = 0.15
"""Typical errors in real robots' files: few digits, or boxes fitted to meshes."""


def odd_inertias(root: ET.Element) -> dict[str, Vector]:
    """Return links' principal moments, kg m², if one is negative or exceeds the sum of the others.

    An excess within rounding is ignored. The URDF must have passed `check_urdf`.
    """
    found = {}
    for link in root.findall("link"):
        if link.find("inertial") is None:
            continue
        principal = np.sort(eigenvalues(_tensor(link))[0])
        if _excess(principal) > _ROUNDING or principal[0] < 0.0:
            found[link.get("name", "")] = principal
    return found


def judge_inertias(root: ET.Element, moving: set[str], *, repair: bool) -> list[str]:
    """Return warnings about impossible inertias that `mend_inertias` will replace.

    Args:
        root: the URDF.
        moving: names of the joints that move; fixed links may have any inertia.
        repair: also accept inertias that are far from possible ones.

    Raises:
        RobotDescriptionError: an inertia is too far off.
    """
    said = []
    mover = movers(root, moving)
    for link, principal in odd_inertias(root).items():
        excess = _excess(principal)
        if mover[link] is None:
            continue
        if excess > _SLIGHT and not repair:
            raise RobotDescriptionError(
                f"link {link} has principal moments of inertia {principal.tolist()}; none may be"
                " negative or exceed the sum of the others (robot.repair: true raises the smaller"
                " ones as far as necessary)"
            )
        if excess <= _ROUNDING:
            continue
        said.append(
            f"the inertia of link {link} breaks the triangle rule by {100 * excess:.2g} % of its"
            " largest moment: its smaller moments are raised as far as necessary"
        )
    return said


def massless_inertias(root: ET.Element, moving: set[str]) -> list[str]:
    """Return names of moving links with a rotational inertia but no mass."""
    mover = movers(root, moving)
    return [
        name
        for link in root.findall("link")
        if mover[name := link.get("name", "")] is not None
        and mass_of(link) == 0.0
        and any(inertia_of(link))
    ]


def movers(root: ET.Element, moving: set[str]) -> dict[str, str | None]:
    """Return the last moving joint on the way to each link; None for fixed links."""
    carriers: dict[str, tuple[str, str]] = {}
    for joint in root.findall("joint"):
        parent, child = joint_ends(joint)
        carriers[child] = (joint.get("name", ""), parent)

    def mover(link: str) -> str | None:
        while link in carriers:
            joint, link = carriers[link]
            if joint in moving:
                return joint
        return None

    return {name: mover(name) for link in root.findall("link") if (name := link.get("name", ""))}


def mend_inertias(root: ET.Element) -> None:
    """Replace impossible inertias by the nearest possible ones with the same largest moment."""
    odd = odd_inertias(root)
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


def _excess(principal: NDArray[np.floating]) -> float:
    """Return how far ascending principal moments violate the rule, as a share of the largest."""
    worst = max(-principal[0], principal[2] - principal[0] - principal[1])
    return float(worst / max(abs(principal[2]), 1e-12))


def _tensor(link: ET.Element) -> Matrix:
    xx, xy, xz, yy, yz, zz = inertia_of(link)
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def check_moved_masses(root: ET.Element, moving: set[str]) -> None:
    """Refuse moving links without inertia: a torque would accelerate them infinitely.

    Args:
        root: the URDF.
        moving: names of the joints that move.

    Raises:
        RobotDescriptionError: a moving link and all links fixed to it have no mass.
    """
    mover = movers(root, moving)
    heavy = {
        mover[link.get("name", "")]
        for link in root.findall("link")
        if mass_of(link) > 0.0 or any(inertia_of(link))
    }
    for joint in root.findall("joint"):
        name = joint.get("name", "")
        if name in moving and name not in heavy:
            raise RobotDescriptionError(
                f"link {joint_ends(joint)[1]}, which joint {name} moves, and the links fixed to it"
                " have no inertia: give it an <inertial> with a mass, make the joint fixed, or"
                " leave it out of robot.joints"
            )

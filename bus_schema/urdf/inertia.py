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


def judge_inertias(root: ET.Element, moving: set[str], *, repair: bool) -> list[str]:
    """Return warnings about inertias that are replaced, or belong to no real body.

    Args:
        root: the URDF, which passed `check_urdf`.
        moving: names of the joints that move; fixed links may have any inertia.
        repair: also accept inertias that are far from possible ones.

    Raises:
        RobotDescriptionError: a moving link has no inertia, or one too far from possible ones.
    """
    movers = _movers(root, moving)
    moved = {name: link for link in root.findall("link") if (name := link.get("name")) in movers}
    heavy = {movers[name] for name, link in moved.items() if mass_of(link) or any(inertia_of(link))}
    for joint in root.findall("joint"):
        if (name := joint.get("name", "")) in moving and name not in heavy:
            raise RobotDescriptionError(
                f"link {joint_ends(joint)[1]}, which joint {name} moves, and the links fixed to it"
                " have no inertia: give it an <inertial> with a mass, make the joint fixed, or"
                " leave it out of robot.joints"
            )
    said = [warning for name in moved if (warning := _judged(name, moved[name], repair=repair))]
    massless = [name for name in moved if not mass_of(moved[name]) and any(inertia_of(moved[name]))]
    if massless:
        said.append(
            f"{', '.join(massless)}: inertia without mass, which no rigid body has; it is used as"
            " given"
        )
    return said


def mend_inertias(root: ET.Element) -> None:
    """Replace impossible inertias by the nearest possible ones with the same largest moment."""
    for link in root.findall("link"):
        principal = _principal(link)
        if _excess(principal) > _ROUNDING or principal[0] < 0.0:
            tensor, element = _mended(_tensor(link)), link.find("inertial/inertia")
            assert element is not None
            places = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
            for name, place in zip(INERTIA, places, strict=True):
                element.set(name, repr(float(tensor[place])))


def _movers(root: ET.Element, moving: set[str]) -> dict[str, str]:
    """Return the last moving joint on the way to each link that moves."""
    joints = {joint_ends(joint)[1]: joint for joint in root.findall("joint")}
    movers: dict[str, str] = {}
    for end in joints:
        link = end
        while (joint := joints.get(link)) is not None:
            if (name := joint.get("name", "")) in moving:
                movers[end] = name
                break
            link, _ = joint_ends(joint)
    return movers


def _judged(name: str, link: ET.Element, *, repair: bool) -> str:
    """Return a warning if `mend_inertias` will visibly replace a moving link's inertia."""
    principal = _principal(link)
    excess = _excess(principal)
    if excess > _SLIGHT and not repair:
        raise RobotDescriptionError(
            f"link {name} has principal moments of inertia {principal.tolist()}; none may be"
            " negative or exceed the sum of the others (robot.repair: true raises the smaller"
            " ones as far as necessary)"
        )
    if excess <= _ROUNDING:
        return ""
    return (
        f"the inertia of link {name} breaks the triangle rule by {100 * excess:.2g} % of its"
        " largest moment: its smaller moments are raised as far as necessary"
    )


def _principal(link: ET.Element) -> Vector:
    """Return a link's principal moments in ascending order, kg m², shape (3,)."""
    return np.sort(eigenvalues(_tensor(link))[0])


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

"""Masses and inertias of MJCF bodies: as they are given, or those of their geoms."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.errors import RobotDescriptionError
from bus_schema.mjcf.settings import (
    Attributes,
    Compiler,
    numbers,
    onto_z,
    orientation,
    vector,
)
from bus_schema.urdf.checks import shortened

_WATER = "1000"
_SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3, "box": 3}
"""How many numbers give the size of a geom that has a mass."""
_MESHES = ("mesh", "sdf")


class Inertial(NamedTuple):
    """Mass (kg), centre (m) and inertia about it (kg m²), in the body's frame."""

    mass_kg: float
    centre: Vector
    inertia: Matrix


@dataclass(frozen=True)
class Solid:
    """A geom with a shape: its kind, half sizes (m) and place in the body's frame."""

    kind: str
    size: Vector
    centre: Vector
    turn: Matrix


def inertial_of(
    name: str,
    body: ET.Element,
    geoms: Sequence[tuple[Attributes, Solid | None]],
    compiler: Compiler,
) -> Inertial | None:
    """The inertia of a body; None for a body without.

    Args:
        name: of the body.
        body: its element.
        geoms: the attributes of its geoms, defaults applied, and what they are.
        compiler: settings of the file.

    Raises:
        RobotDescriptionError: it has none where it must, or it cannot be read.
    """
    element = body.find("inertial")
    given = None
    if element is not None:
        given = _given(f"inertial of body {name}", element.attrib, compiler)
    by_geoms = compiler.inertia_from_geoms
    if by_geoms is False or (given is not None and not by_geoms):
        return given
    weighing = [(attributes, solid) for attributes, solid in geoms if _weighs(attributes)]
    for attributes, _ in weighing:
        _require_known_inertia(name, attributes)
    parts = [_of_solid(attributes, solid) for attributes, solid in weighing if solid is not None]
    return _sum([part for part in parts if part.mass_kg > 0.0]) or given


def solid_of(attributes: Attributes, owner: str, compiler: Compiler) -> Solid | None:
    """What a geom is; None for planes, fields and meshes, which have no simple shape.

    Args:
        attributes: of the geom, defaults applied.
        owner: what it is a part of.
        compiler: settings of the file.

    Raises:
        RobotDescriptionError: it cannot be read.
    """
    kind = attributes.get("type", "sphere")
    if kind not in _SIZES:
        return None
    owner = _shown(attributes, owner)
    size = numbers(owner, attributes, "size", "")
    centre = vector(owner, attributes, "pos", "0 0 0")
    if "fromto" in attributes:
        ends = vector(owner, attributes, "fromto", "0 0 0 0 0 0").reshape(2, 3)
        axis = ends[0] - ends[1]
        centre, turn = ends.mean(axis=0), onto_z(owner, "fromto", axis)
        half = float(np.linalg.norm(axis)) / 2
        size = np.array([*np.repeat(size[:1], _SIZES[kind] - 1), half])
    else:
        turn = orientation(owner, attributes, compiler)
    if len(size) < _SIZES[kind] or (size[: _SIZES[kind]] <= 0.0).any():
        raise RobotDescriptionError(
            f"size of {owner}: must be {_SIZES[kind]} positive numbers for a {kind}"
        )
    return Solid(kind, size[: _SIZES[kind]], centre, turn)


def _shown(attributes: Attributes, owner: str) -> str:
    return f"geom {shortened(attributes.get('name', ''))}".strip() + f" of {owner}"


def _weighs(attributes: Attributes) -> bool:
    """Whether a geom adds to its body's inertia: what is only to be seen has no mass or density."""
    (factor,) = vector("geom", attributes, "mass" if "mass" in attributes else "density", _WATER)
    return bool(factor != 0.0)


def _require_known_inertia(body: str, attributes: Attributes) -> None:
    """Refuse a geom whose inertia is none of a uniform solid's.

    Raises:
        RobotDescriptionError: it is a mesh, or a shell.
    """
    if attributes.get("type") in _MESHES:
        raise RobotDescriptionError(
            f"body {body} has the inertia of a mesh: give it an <inertial> with mass and inertia,"
            ' or its mesh mass="0"'
        )
    shell = attributes.get("shellinertia", "false")
    if shell != "false":
        raise RobotDescriptionError(
            f"shellinertia={shortened(shell)!r} of {_shown(attributes, f'body {body}')}:"
            " must be false, or the body must have an <inertial>"
        )


def _given(owner: str, attributes: Attributes, compiler: Compiler) -> Inertial:
    (mass,) = vector(owner, attributes, "mass", "0")
    turn = orientation(owner, attributes, compiler)
    if "fullinertia" in attributes:
        xx, yy, zz, xy, xz, yz = vector(owner, attributes, "fullinertia", "0 0 0 0 0 0")
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    else:
        inertia = np.diag(vector(owner, attributes, "diaginertia", "0 0 0"))
    centre = vector(owner, attributes, "pos", "0 0 0")
    return Inertial(float(mass), centre, turn @ inertia @ turn.T)


def _of_solid(attributes: Attributes, solid: Solid) -> Inertial:
    volume, per_mass = _uniform(solid.kind, solid.size)
    if "mass" in attributes:
        (mass,) = vector("geom", attributes, "mass", "0")
    else:
        (density,) = vector("geom", attributes, "density", _WATER)
        mass = density * volume
    inertia = solid.turn @ np.diag(mass * per_mass) @ solid.turn.T
    return Inertial(float(mass), solid.centre, inertia)


def _uniform(kind: str, size: Vector) -> tuple[float, Vector]:
    """Volume of a solid, m³, and its principal moments per mass, m²."""
    match kind:
        case "sphere":
            r = size[0]
            return 4.0 / 3.0 * math.pi * r**3, np.full(3, 0.4 * r**2)
        case "ellipsoid":
            squares = size**2
            return 4.0 / 3.0 * math.pi * float(size.prod()), (squares.sum() - squares) / 5.0
        case "box":
            squares = size**2
            return 8.0 * float(size.prod()), (squares.sum() - squares) / 3.0
        case "cylinder":
            r, half = size
            across = (3.0 * r**2 + 4.0 * half**2) / 12.0
            return 2.0 * math.pi * r**2 * half, np.array([across, across, r**2 / 2.0])
    r, half = size  # a capsule: a cylinder and two half spheres
    tube, ball = 2.0 * math.pi * r**2 * half, 4.0 / 3.0 * math.pi * r**3
    across = tube * (3.0 * r**2 + 4.0 * half**2) / 12.0 + ball * (
        0.4 * r**2 + half**2 + 0.75 * half * r
    )
    along = tube * r**2 / 2.0 + ball * 0.4 * r**2
    return tube + ball, np.array([across, across, along]) / (tube + ball)


def _sum(parts: list[Inertial]) -> Inertial | None:
    """All of them as one body."""
    if not parts:
        return None
    mass = sum(part.mass_kg for part in parts)
    centre = np.asarray(sum(part.mass_kg * part.centre for part in parts) / mass)
    inertia = np.zeros((3, 3))
    for part in parts:
        off = part.centre - centre
        inertia += part.inertia + part.mass_kg * (off @ off * np.eye(3) - np.outer(off, off))
    return Inertial(float(mass), centre, inertia)

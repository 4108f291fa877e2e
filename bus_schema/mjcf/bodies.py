"""Masses and inertias of MJCF bodies: as they are given, or those of their geoms."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.errors import RobotDescriptionError
from bus_schema.mjcf.settings import (
    Attributes,
    Compiler,
    Defaults,
    numbers,
    onto_z,
    orientation,
    vector,
)

_WATER = "1000"
_SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3, "box": 3}
"""How many numbers give the size of a geom that has a mass."""


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
    name: str, body: ET.Element, solids: list[tuple[Attributes, Solid]], compiler: Compiler
) -> Inertial | None:
    """The inertia of a body; None for a body without.

    Raises:
        RobotDescriptionError: it has none where it must, or it cannot be read.
    """
    given = body.find("inertial")
    if given is not None and compiler.inertia_from_geoms is not True:
        return _given(f"inertial of body {name}", given.attrib, compiler)
    if compiler.inertia_from_geoms is False:
        return None
    if any(geom.get("type") == "mesh" for geom in body.findall("geom")):
        raise RobotDescriptionError(
            f"body {name} has the inertia of a mesh: give it an <inertial> with mass and inertia"
        )
    parts = [_of_solid(attributes, solid) for attributes, solid in solids]
    return _sum([part for part in parts if part.mass_kg > 0.0])


def solid_of(
    geom: ET.Element, owner: str, defaults: Defaults, child_class: str | None, compiler: Compiler
) -> tuple[Attributes, Solid] | None:
    """What a geom is; None for planes, fields and meshes, which have no simple shape.

    Raises:
        RobotDescriptionError: it cannot be read.
    """
    attributes = defaults.of(geom, child_class)
    kind = attributes.get("type", "sphere")
    if kind not in _SIZES:
        return None
    owner = f"geom {attributes.get('name', '')}".strip() + f" of {owner}"
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
    return attributes, Solid(kind, size[: _SIZES[kind]], centre, turn)


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

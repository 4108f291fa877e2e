"""What holds for a whole MJCF file: its compiler's settings, and the defaults of its classes."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.errors import RobotDescriptionError
from bus_schema.urdf.checks import finite_number, shortened

DEEPEST = 100
"""How many elements may lie within one another."""
_SEQUENCE = "eulerseq"
_ACTUATORS = {
    *("general", "motor", "position", "velocity", "intvelocity", "damper", "cylinder", "muscle"),
    *("adhesion", "dcmotor", "plugin"),
}
Attributes = Mapping[str, str]


class Defaults:
    """Attributes that elements have unless they say otherwise, by class.

    Args:
        root: the file.
    """

    def __init__(self, root: ET.Element) -> None:
        self._classes: dict[str, dict[str, dict[str, str]]] = {"main": {}}
        for top in root.findall("default"):
            self._read(top, {}, "main", 1)

    def of(self, element: ET.Element, child_class: str | None) -> dict[str, str]:
        """Attributes of an element, with those of its class, or else of its body's.

        Raises:
            RobotDescriptionError: there is no such class.
        """
        name = element.get("class") or child_class or "main"
        if name not in self._classes:
            known = ", ".join(self._classes)
            raise RobotDescriptionError(
                f"class={shortened(name)!r} of {_shown(element)}: must be one of {known}"
            )
        return {**self._classes[name].get(_setting(element), {}), **element.attrib}

    def _read(
        self, default: ET.Element, inherited: dict[str, dict[str, str]], name: str, depth: int
    ) -> None:
        if depth > DEEPEST:
            raise RobotDescriptionError(f"more than {DEEPEST} defaults lie within one another")
        values = {tag: dict(attributes) for tag, attributes in inherited.items()}
        for each in default:
            if each.tag != "default":
                setting = _setting(each)
                values[setting] = {**values.get(setting, {}), **each.attrib}
        self._classes[name] = values
        for inner in default.findall("default"):
            self._read(inner, values, inner.get("class", ""), depth + 1)


@dataclass(frozen=True)
class Compiler:
    """Settings of the element ``compiler``.

    Attributes:
        in_degrees: angles are in degrees.
        sequence: axes of Euler angles, small letters for axes that turn along.
        auto_limits: a range limits, whether or not it is said to.
        inertia_from_geoms: True, False, or None where a body says it has inertia of its own.
    """

    in_degrees: bool
    sequence: str
    auto_limits: bool
    inertia_from_geoms: bool | None

    def angle(self, value: float) -> float:
        return math.radians(value) if self.in_degrees else value


def compiler_of(root: ET.Element) -> Compiler:
    """Read the settings.

    Raises:
        RobotDescriptionError: one is not understood.
    """
    given: dict[str, str] = {}
    for each in root.findall("compiler"):
        given |= each.attrib
    if given.get("coordinate", "local") != "local":
        raise _refused("compiler", "coordinate", given["coordinate"], "local")
    for name in ("settotalmass", "inertiagrouprange"):
        if name in given:
            raise RobotDescriptionError(f"compiler {name} is not understood: must be left out")
    sequence = given.get(_SEQUENCE, "xyz")
    if len(sequence) != 3 or set(sequence.lower()) - set("xyz"):
        raise _refused("compiler", _SEQUENCE, sequence, "three of x, y and z")
    from_geoms = given.get("inertiafromgeom", "auto")
    choices = {"true": True, "false": False, "auto": None}
    if from_geoms not in choices:
        raise _refused("compiler", "inertiafromgeom", from_geoms, ", ".join(choices))
    return Compiler(
        in_degrees=given.get("angle", "degree") != "radian",
        sequence=sequence,
        auto_limits=given.get("autolimits", "true") == "true",
        inertia_from_geoms=choices[from_geoms],
    )


def numbers(owner: str, attributes: Attributes, name: str, default: str) -> Vector:
    """The numbers in an attribute.

    Raises:
        RobotDescriptionError: there is something else in it.
    """
    text = attributes.get(name, default)
    return np.array([finite_number(owner, name, part) for part in text.split()])


def vector(owner: str, attributes: Attributes, name: str, default: str) -> Vector:
    """As `numbers`, of which there are as many as in the default.

    Raises:
        RobotDescriptionError: there are more or fewer.
    """
    values, wanted = numbers(owner, attributes, name, default), len(default.split())
    if len(values) != wanted:
        raise _refused(owner, name, attributes[name], f"{wanted} numbers")
    return values


def orientation(owner: str, attributes: Attributes, compiler: Compiler) -> Matrix:
    """How a frame is turned against its parent's, as a matrix.

    Raises:
        RobotDescriptionError: it cannot be read, or is no turn.
    """
    if "axisangle" in attributes:
        *axis, angle = vector(owner, attributes, "axisangle", "0 0 1 0")
        return turned(owner, "axisangle", np.array(axis), compiler.angle(angle))
    if "euler" in attributes:
        found = np.eye(3)
        for letter, angle in zip(
            compiler.sequence, vector(owner, attributes, "euler", "0 0 0"), strict=True
        ):
            axis_now = np.eye(3)["xyz".index(letter.lower())]
            turn = turned(owner, "euler", axis_now, compiler.angle(angle))
            found = found @ turn if letter.islower() else turn @ found
        return found
    if "xyaxes" in attributes:
        x, y = vector(owner, attributes, "xyaxes", "1 0 0 0 1 0").reshape(2, 3)
        x = unit(owner, "xyaxes", x)
        y = unit(owner, "xyaxes", y - (x @ y) * x)
        return np.column_stack([x, y, np.cross(x, y)])
    if "zaxis" in attributes:
        return onto_z(owner, "zaxis", vector(owner, attributes, "zaxis", "0 0 1"))
    w, *v = unit(owner, "quat", vector(owner, attributes, "quat", "1 0 0 0"))
    return _matrix(w, np.array(v))


def turned(owner: str, name: str, axis: Vector, angle_rad: float) -> Matrix:
    """A turn about an axis."""
    return _matrix(math.cos(angle_rad / 2), unit(owner, name, axis) * math.sin(angle_rad / 2))


def onto_z(owner: str, name: str, direction: Vector) -> Matrix:
    """The least turn that brings z to a direction."""
    z = unit(owner, name, direction)
    if z[2] < -1.0 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    return _matrix(*_normal(1.0 + z[2], np.cross([0.0, 0.0, 1.0], z)))


def unit(owner: str, name: str, values: Vector) -> Vector:
    """The same direction with length 1.

    Raises:
        RobotDescriptionError: there is none.
    """
    length = float(np.linalg.norm(values))
    if length == 0.0:
        raise RobotDescriptionError(f"{name} of {owner} is zero: it must have a direction")
    return np.asarray(values / length)


def _normal(w: float, v: Vector) -> tuple[float, Vector]:
    length = math.sqrt(w * w + float(v @ v))
    return w / length, v / length


def _matrix(w: float, v: Vector) -> Matrix:
    """The matrix of a unit quaternion."""
    cross = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    return np.asarray(np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross)


def _refused(owner: str, name: str, value: str, allowed: str) -> RobotDescriptionError:
    return RobotDescriptionError(f"{name}={shortened(value)!r} of {owner}: must be {allowed}")


def _setting(element: ET.Element) -> str:
    """What an element's defaults go by: all actuators share theirs, as each is a `general` one."""
    return "general" if element.tag in _ACTUATORS else element.tag


def _shown(element: ET.Element) -> str:
    return f"{element.tag} {element.get('name', '')}".strip()

"""Conversion of MJCF (MuJoCo's format) to URDF from the numbers that MuJoCo compiles.

Elements without a URDF equivalent are left out with a warning (springs), held (joints that tendons
or equality constraints couple), or refused (ball joints).

Importing this module imports MuJoCo, so import it where it is used.
"""

from __future__ import annotations

import json
import math
import sys
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.errors import RobotDescriptionError
from bus_schema.mujoco_library import mujoco
from bus_schema.runtime.limited_process import (
    LimitedProcess,
    LimitedProcessError,
    limit_this_process,
)
from bus_schema.urdf.drive_values import MOTOR_VALUES
from bus_schema.urdf.held_pose import roll_pitch_yaw
from bus_schema.urdf.mjcf_actuators import JointActuators
from bus_schema.urdf.mjcf_files import (
    HINGE_AND_SLIDE,
    SHAPES,
    MjcfFiles,
    one_element_a_line,
    parsed,
    reason,
    reduce_spec,
)
from bus_schema.urdf.mjcf_joints import drives_of

_GEOM, _JOINT = mujoco.mjtGeom, mujoco.mjtJoint
_Frame = tuple[Vector, Vector]
"""Position (m) and orientation (quaternion) of a frame."""
_KINDS = dict(zip(HINGE_AND_SLIDE, ("revolute", "prismatic"), strict=True))


def urdf_from_mjcf(
    root: ET.Element,
    path: Path,
    driven: Sequence[str] | None,
    hold: Collection[str],
    include: Sequence[Path],
) -> tuple[ET.Element, list[str]]:
    """Convert an arm in MJCF to URDF.

    Args:
        root: the MJCF file; it is modified.
        path: that file.
        driven: names of the joints to drive; None for those of the arm.
        hold: names of further joints that the URDF has as movable ones.
        include: folders that may be read, besides its own and the one around it.

    Returns:
        The URDF, and warnings about what was left out.

    Raises:
        RobotDescriptionError: MuJoCo refuses it, or a URDF cannot represent it.
    """
    spec, free = _specification(root, path, include)
    if not spec.meshes:
        urdf, notes = _converted(spec, root, driven, hold)
        return urdf, [f"MJCF: {each}" for each in (*free, *notes)]
    order = json.dumps([str(path), driven, [*hold], list(map(str, include))])
    try:  # a mesh may crash MuJoCo
        text, notes = json.loads(LimitedProcess(__name__, order.encode()).answer())
    except LimitedProcessError as error:
        raise RobotDescriptionError(
            f"its inertias are those of meshes, which are damaged or too large ({error})"
        ) from error
    if not text:
        raise RobotDescriptionError(notes)
    return ET.fromstring(text), [f"MJCF: {each}" for each in (*free, *notes)]


def main() -> None:
    """Convert the file that standard input names; write the URDF and warnings, or why not."""
    limit_this_process(cpu_s=8)
    path, driven, hold, include = json.load(sys.stdin.buffer)
    root = parsed(Path(path))
    try:
        spec, _ = _specification(root, Path(path), list(map(Path, include)))
        urdf, notes = _converted(spec, root, driven, hold)
        print(json.dumps([ET.tostring(urdf, encoding="unicode"), notes]))
    except RobotDescriptionError as error:
        print(json.dumps(["", str(error)]))


def _specification(root: ET.Element, path: Path, include: Sequence[Path]) -> tuple[Any, list[str]]:
    """Return the specification of an arm, and warnings."""
    files = MjcfFiles(path, include)
    files.prepare(root, path.resolve().parent)
    with _of_mujoco(root):
        spec = mujoco.MjSpec.from_string(one_element_a_line(root))
        return spec, [*files.warnings, *reduce_spec(spec, files)]


def _converted(
    spec: Any, root: ET.Element, driven: Sequence[str] | None, hold: Collection[str]
) -> tuple[ET.Element, list[str]]:
    """Return the URDF of a specification, and warnings."""
    with _of_mujoco(root):
        model = spec.compile()
    drives, held = drives_of(model, driven, hold)
    urdf = ET.Element("robot", name=root.get("model", "mjcf"))
    ET.SubElement(urdf, "link", name="world")
    origins = [np.zeros(3)]
    for body in range(1, model.nbody):  # each body after its parent
        origins.append(_write_body(urdf, model, body, origins, drives))
    return urdf, [*held, *_left_out(model)]


@contextmanager
def _of_mujoco(root: ET.Element) -> Iterator[None]:
    """Raise errors of MuJoCo as those of the arm, without its warnings."""
    try:
        with warnings.catch_warnings(action="ignore"):
            yield
    except RobotDescriptionError:
        raise
    except (ValueError, mujoco.FatalError) as error:
        raise RobotDescriptionError(f"MuJoCo: {reason(error, root)}") from error


def _left_out(model: Any) -> Iterator[str]:
    """Return warnings about elements that a URDF cannot represent."""
    if names := ", ".join(f"body {model.body(i).name}" for i in model.body_gravcomp.nonzero()[0]):
        yield f"gravcomp of {names} is left out: gravity acts on the whole arm"
    if (gravity := model.opt.gravity.tolist()) != [0.0, 0.0, -9.81]:
        shown = " ".join(f"{part:g}" for part in gravity)
        yield f"its gravity {shown} is left out: it is 0 0 -9.81 here"


def _write_body(
    urdf: ET.Element,
    model: Any,
    body: int,
    origins: list[Vector],
    drives: Mapping[int, JointActuators],
) -> Vector:
    """Write a body and the joints before it.

    Args:
        urdf: the element to add them to.
        model: the compiled model.
        body: the body's number.
        origins: origins of the links before it, each in its body's frame.
        drives: drives of the joints that are not held.

    Returns:
        The origin of the link, at the body's last joint.
    """
    name, carrier = model.body(body).name, model.body_parentid[body]
    first, joints = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    parent, origin = model.body(carrier).name, np.zeros(3)
    at, turn = model.body_pos[body] - origins[carrier], model.body_quat[body]
    for index, joint in enumerate(map(model.joint, range(first, first + joints)), start=1):
        at = at + _rotated(joint.pos - origin, turn)
        link = name if index == joints else f"{name}_{index}"
        _write_joint(urdf, joint, drives.get(joint.id), (parent, link), (at, turn))
        if link != name:  # it weighs nothing, and is refused if it has to move
            ET.SubElement(urdf, "link", name=link)
        parent, at, turn, origin = link, np.zeros(3), np.eye(4)[0], joint.pos
    if not joints:
        _connect(urdf, (f"{name}_fixed", "fixed"), (parent, name), (at, turn))
    _write_link(ET.SubElement(urdf, "link", name=name), model, body, origin)
    return origin


def _write_joint(
    urdf: ET.Element, joint: Any, drive: JointActuators | None, ends: tuple[str, str], frame: _Frame
) -> None:
    """Write a joint; a joint without a drive is held."""
    (at, turn), (reference,) = frame, joint.qpos0
    kind = _KINDS[_JOINT(joint.type[0])]
    if kind == "prismatic":
        at = at - reference * _rotated(joint.axis, turn)
    else:
        back, before, turn = np.zeros(4), turn, np.zeros(4)
        mujoco.mju_axisAngle2Quat(back, joint.axis, -reference)
        mujoco.mju_mulQuat(turn, before, back)
    if drive is None:
        _connect(urdf, (joint.name, "fixed"), ends, (at, turn))
        return
    names = ("lower", "upper", "effort", "velocity")
    limit = {name: each for name in names if math.isfinite(each := getattr(drive, name))}
    if kind == "revolute" and "lower" not in limit:
        kind = "continuous"
    element = _connect(urdf, (joint.name, kind), ends, (at, turn))
    ET.SubElement(element, "axis", xyz=_text(joint.axis))
    ET.SubElement(element, "limit", {key: _text(value) for key, value in limit.items()})
    friction = {"damping": drive.viscous, "friction": drive.coulomb}
    ET.SubElement(element, "dynamics", {key: _text(value) for key, value in friction.items()})
    transmission = ET.SubElement(urdf, "transmission")
    ET.SubElement(transmission, "joint", name=joint.name)
    actuator = ET.SubElement(transmission, "actuator")
    for name in MOTOR_VALUES:
        ET.SubElement(actuator, name, value=_text(getattr(drive, name)))


def _write_link(link: ET.Element, model: Any, body: int, origin: Vector) -> None:
    """Write a body's inertia and its visible geoms."""
    if model.body_mass[body] > 0.0:
        inertial = ET.SubElement(link, "inertial")
        _place(inertial, (model.body_ipos[body] - origin, model.body_iquat[body]))
        ET.SubElement(inertial, "mass", value=_text(model.body_mass[body]))
        moments = [*map(_text, model.body_inertia[body]), "0", "0", "0"]
        names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
        ET.SubElement(inertial, "inertia", dict(zip(names, moments, strict=True)))
    for geom in np.flatnonzero(model.geom_bodyid == body):
        if _GEOM(model.geom_type[geom]) not in SHAPES:
            continue
        visual = ET.SubElement(link, "visual")
        _place(visual, (model.geom_pos[geom] - origin, model.geom_quat[geom]))
        shape, size = SHAPES[_GEOM(model.geom_type[geom])], model.geom_size[geom]
        sizes = {
            "box": {"size": _text(2.0 * size)},
            "cylinder": {"radius": _text(size[0]), "length": _text(2.0 * size[1])},
            "sphere": {"radius": _text(size[size > 0.0].mean())},
        }
        ET.SubElement(ET.SubElement(visual, "geometry"), shape, sizes[shape])


def _rotated(vector: Vector, turn: Vector) -> Vector:
    """Rotate a vector by a quaternion with MuJoCo: NumPy's ``@`` depends on the CPU."""
    found = np.zeros(3)
    mujoco.mju_rotVecQuat(found, vector, turn)
    return found


def _connect(
    urdf: ET.Element, named: tuple[str, str], ends: tuple[str, str], frame: _Frame
) -> ET.Element:
    """Add a joint of this name and type between two links."""
    joint = ET.SubElement(urdf, "joint", name=named[0], type=named[1])
    ET.SubElement(joint, "parent", link=ends[0])
    ET.SubElement(joint, "child", link=ends[1])
    _place(joint, frame)
    return joint


def _place(element: ET.Element, frame: _Frame) -> None:
    """Write a frame's position, and its orientation as roll, pitch and yaw."""
    at, turn = frame
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, turn)
    ET.SubElement(element, "origin", xyz=_text(at), rpy=_text(roll_pitch_yaw(matrix.reshape(3, 3))))


def _text(values: Vector | float) -> str:
    return " ".join(repr(float(each)) for each in np.atleast_1d(values))


if __name__ == "__main__":
    main()

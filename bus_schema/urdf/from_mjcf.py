"""Conversion of MJCF (MuJoCo's format) to URDF from the numbers that MuJoCo compiles.

Elements that open files, and purely visual ones, are removed before MuJoCo reads the file. Elements
without a URDF equivalent are left out with a warning (springs), or refused (loops, ball joints).

Importing this module imports MuJoCo, so import it where it is used.
"""

from __future__ import annotations

import math
import re
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count
from typing import Any

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.errors import RobotDescriptionError
from bus_schema.mujoco_library import mujoco
from bus_schema.urdf.checks import check_depth, shortened

_DEEPEST = 200
_MOST_ELEMENTS = 5000  # MuJoCo's time grows with the square of their number: 1.5 s for 5000 bodies
_NO_TREE = ("tendon", "equality", "deformable", "extension")
_MACROS = ("include", "composite", "flexcomp", "replicate", "attach")
_ONLY_SEEN = {
    *("asset", "visual", "sensor", "contact", "keyframe", "size", "statistic", "custom"),
    *("site", "camera", "light", "mesh", "material", "skin", "pair", "tendon", "equality", "flag"),
}
_NOT_FINITE = re.compile(r"[+-]?(nan(\(.*\))?|inf(inity)?)", re.IGNORECASE)
_GEOM, _JOINT, _TARGET = mujoco.mjtGeom, mujoco.mjtJoint, mujoco.mjtTrn
_SHAPES = {
    _GEOM.mjGEOM_SPHERE: "sphere",
    _GEOM.mjGEOM_ELLIPSOID: "sphere",
    _GEOM.mjGEOM_BOX: "box",
    _GEOM.mjGEOM_CYLINDER: "cylinder",
    _GEOM.mjGEOM_CAPSULE: "cylinder",
}
"""The nearest URDF shape for each simple geom."""
_Frame = tuple[Vector, Vector]
"""Position (m) and orientation (quaternion) of a frame."""
_AFFINE = mujoco.mjtBias.mjBIAS_AFFINE
_KINDS = {_JOINT.mjJNT_HINGE: "revolute", _JOINT.mjJNT_SLIDE: "prismatic"}


def urdf_from_mjcf(root: ET.Element) -> tuple[ET.Element, list[str]]:
    """Convert an arm in MJCF to URDF.

    Args:
        root: the MJCF file; it is modified.

    Returns:
        The URDF, and warnings about what was left out.

    Raises:
        RobotDescriptionError: MuJoCo refuses it, or a URDF cannot represent it.
    """
    _prepare(root)
    try:
        with warnings.catch_warnings(action="ignore"):
            spec = mujoco.MjSpec.from_string(_one_element_a_line(root))
            free = _reduce(spec)
            model = spec.compile()
    except RobotDescriptionError:
        raise
    except (ValueError, mujoco.FatalError) as error:
        raise RobotDescriptionError(f"MuJoCo: {_reason(error, root)}") from error
    urdf, drives = ET.Element("robot", name=root.get("model", "mjcf")), _drives(model)
    ET.SubElement(urdf, "link", name="world")
    origins = [np.zeros(3)]
    for body in range(1, model.nbody):  # each body after its parent
        origins.append(_write_body(urdf, model, body, origins, drives))
    return urdf, [f"MJCF: {each}" for each in (*free, *_left_out(model, drives))]


def _prepare(root: ET.Element) -> None:
    """Drop visual elements, and refuse elements that open files or multiply."""
    check_depth(root, _DEEPEST)
    for found in (each for tag in _NO_TREE for part in root.findall(tag) for each in part):
        raise RobotDescriptionError(
            f"{_shown(found)}: must be left out, because only a tree of bodies can be emulated"
        )
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag in _ONLY_SEEN:
                parent.remove(child)
    for option in root.findall("option"):  # old files contain some that current MuJoCo refuses
        option.attrib = {key: text for key, text in option.attrib.items() if key == "gravity"}
    elements = list(root.iter())
    if len(elements) > _MOST_ELEMENTS:
        raise RobotDescriptionError(f"has {len(elements)} elements: at most {_MOST_ELEMENTS}")
    for element in elements:
        if element.tag in _MACROS or "file" in element.attrib:
            raise RobotDescriptionError(
                f"{_shown(element)} is not supported: write its contents out"
            )
        for name, text in element.attrib.items():
            if any(_NOT_FINITE.fullmatch(part) for part in text.split()):
                raise RobotDescriptionError(f"{name} of {_shown(element)} is not a finite number")


def _one_element_a_line(root: ET.Element) -> str:
    """Write the n-th element on the n-th line, so that MuJoCo's errors identify it."""
    for element in root.iter():
        element.text = "\n" if len(element) else ""
        for child in element:
            child.tail = "\n" if child is not element[-1] else ""
    return ET.tostring(root, encoding="unicode")


def _reason(error: Exception, root: ET.Element) -> str:
    """Return MuJoCo's reason, with the element concerned."""
    said = " ".join(str(error).removeprefix("XML ").removeprefix("Error: ").split())
    if (place := re.search(r" Element .*, line (\d+)$", said)) is None:
        return said
    return f"{said[: place.start()]}: {_shown(list(root.iter())[int(place[1]) - 1])}"


def _shown(element: ET.Element) -> str:
    """Return an element's opening tag."""
    inside = " ".join(f"{name}={text!r}" for name, text in element.attrib.items())
    return f"<{shortened(f'{element.tag} {inside}'.strip())}>"


def _reduce(spec: Any) -> list[str]:
    """Delete free bodies and all meshes; name all bodies and joints.

    Returns:
        Warnings about the free bodies.
    """
    bodies, free_joint = list(spec.worldbody.bodies), mujoco.mjtJoint.mjJNT_FREE
    free = [each for each in bodies if free_joint in (joint.type for joint in each.joints)]
    names = [f"body {shortened(body.name) or '(unnamed)'}" for body in free]
    if free and len(free) == len(bodies):
        allowed = "an arm must be fixed to the world"
        raise RobotDescriptionError(f"{names[0]} has a free joint: {allowed}")
    for body in free:
        spec.delete(body)
    unnamed = count(1)
    for body in spec.bodies:
        body.name = body.name or f"body_{next(unnamed)}"
        for index, joint in enumerate(body.joints, start=1):
            joint.name = joint.name or f"{body.name}_joint_{index}"
            if joint.type not in _KINDS:
                raise RobotDescriptionError(f"joint {shortened(joint.name)} must be hinge or slide")
        for geom in list(body.geoms):
            geom.material = ""
            if geom.type not in _SHAPES or geom.meshname:
                _require_weightless(spec.compiler.inertiafromgeom, body, geom)
                spec.delete(geom)
    for actuator in spec.actuators:
        if actuator.trntype not in (_TARGET.mjTRN_JOINT, _TARGET.mjTRN_JOINTINPARENT):
            raise RobotDescriptionError(f"actuator {shortened(actuator.name)!r} must drive a joint")
    spec.compiler.fusestatic = spec.compiler.discardvisual = False
    spec.compiler.LRopt.mode = mujoco.mjtLRMode.mjLRMODE_NONE  # which would take long to simulate
    return [f"{name} is free, and left out" for name in names]


def _require_weightless(by_geoms: Any, body: Any, geom: Any) -> None:
    """Refuse a geom that adds to the inertia of a moving body, as no mesh file is read."""
    mass = geom.density if math.isnan(geom.mass) else geom.mass
    if mass == 0.0 or geom.type in (_GEOM.mjGEOM_PLANE, _GEOM.mjGEOM_HFIELD):
        return
    if body.explicitinertial and by_geoms == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO:
        return
    carrier = body
    while carrier is not None and not carrier.joints:
        carrier = carrier.parent
    if carrier is not None and by_geoms != mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE:
        raise RobotDescriptionError(
            f"body {shortened(body.name)} has the inertia of a mesh: give it an <inertial> with"
            ' mass and inertia, or its mesh mass="0"'
        )


@dataclass
class _Drive:
    """Limits and gains that the actuators of a joint have there; inf where there is no limit.

    Attributes:
        effort: N m or N.
        velocity: rad/s or m/s, of velocity servos.
        lower: rad or m, the lower end of the range of the joint and of its position servos.
        upper: the upper end.
        stiffness: N m/rad or N/m, of position servos.
        damping: N m s/rad or N s/m, of all servos.
    """

    effort: float = 0.0
    velocity: float = math.inf
    lower: float = -math.inf
    upper: float = math.inf
    stiffness: float = 0.0
    damping: float = 0.0

    def limit_range(self, ends: Vector) -> None:
        """Keep the part of the range that lies between both ends."""
        self.lower, self.upper = max(self.lower, ends.min()), min(self.upper, ends.max())

    def add(self, actuator: Any) -> None:
        """Add an actuator of the joint.

        Its force is gain · control + bias[0] + bias[1] · length + bias[2] · speed, the length being
        the joint's position times the gear. A motor has a gain alone. A servo comes to rest where
        the force is zero.
        """
        gear, bias = float(actuator.gear[0]), actuator.biasprm
        forces = actuator.gainprm[0] * actuator.ctrlrange
        is_limited = bool(actuator.ctrllimited[0]) and gear != 0.0
        has_own_state = bool(actuator.dyntype[0])  # its control is no force and no target
        largest = abs(actuator.forcerange).max() if actuator.forcelimited[0] else math.inf
        if is_limited and not (actuator.gaintype[0] or actuator.biastype[0] or has_own_state):
            largest = min(largest, abs(forces).max())
        self.effort += abs(gear) * largest if gear else 0.0
        if actuator.gaintype[0] or actuator.biastype[0] != _AFFINE:
            return
        self.stiffness -= bias[1] * gear**2
        self.damping -= bias[2] * gear**2
        if is_limited and not has_own_state:
            if bias[1] < 0.0:
                self.limit_range((forces + bias[0]) / (-bias[1] * gear))
            elif bias[2] < 0.0:
                speeds = abs((forces + bias[0]) / (bias[2] * gear))
                self.velocity = min(self.velocity, speeds.max())


def _drives(model: Any) -> dict[int, _Drive]:
    """Return the drives of all joints that have actuators; without any in the file, of all."""
    free = range(0 if model.nu else model.njnt)
    drives = {joint: _Drive(effort=math.inf) for joint in free}
    for actuator in map(model.actuator, range(model.nu)):
        drives.setdefault(int(actuator.trnid[0]), _Drive()).add(actuator)
    for joint, drive in drives.items():
        if model.jnt_limited[joint]:
            drive.limit_range(model.jnt_range[joint])
        if model.jnt_actfrclimited[joint]:
            drive.effort = min(drive.effort, abs(model.jnt_actfrcrange[joint]).max())
    return drives


def _left_out(model: Any, drives: dict[int, _Drive]) -> Iterator[str]:
    """Return warnings about elements that a URDF cannot represent."""
    joints = [model.joint(joint) for joint in range(model.njnt)]
    if passive := ", ".join(joint.name for joint in joints if joint.id not in drives):
        yield f"{passive}: no actuator drives them; they are held"
    driven = [joint for joint in joints if joint.id in drives]
    if any(joint.stiffness.any() for joint in driven):
        yield "stiffness of its joints is left out"
    if names := ", ".join(f"body {model.body(i).name}" for i in model.body_gravcomp.nonzero()[0]):
        yield f"gravcomp of {names} is left out: gravity acts on the whole arm"
    if (gravity := model.opt.gravity.tolist()) != [0.0, 0.0, -9.81]:
        shown = " ".join(f"{part:g}" for part in gravity)
        yield f"its gravity {shown} is left out: it is 0 0 -9.81 here"


def _write_body(
    urdf: ET.Element, model: Any, body: int, origins: list[Vector], drives: dict[int, _Drive]
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
    urdf: ET.Element, joint: Any, drive: _Drive | None, ends: tuple[str, str], frame: _Frame
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
    friction = {"damping": joint.damping, "friction": joint.frictionloss}
    ET.SubElement(element, "dynamics", {key: _text(value) for key, value in friction.items()})
    transmission = ET.SubElement(urdf, "transmission")
    ET.SubElement(transmission, "joint", name=joint.name)
    actuator = ET.SubElement(transmission, "actuator")
    motor = {
        "rotor_inertia": joint.armature, "stiffness": drive.stiffness, "damping": drive.damping
    }  # fmt: skip
    for name, value in motor.items():
        ET.SubElement(actuator, name, value=_text(value))


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
        visual = ET.SubElement(link, "visual")
        _place(visual, (model.geom_pos[geom] - origin, model.geom_quat[geom]))
        shape, size = _SHAPES[_GEOM(model.geom_type[geom])], model.geom_size[geom]
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
    _, xy, xz, _, yy, yz, zx, zy, zz = matrix
    roll = math.atan2(zy, zz)
    sine, cosine = math.sin(roll), math.cos(roll)
    # Yaw of the rotation without its roll, so that all are exact at a pitch of 90 degrees.
    yaw = math.atan2(sine * xz - cosine * xy, cosine * yy - sine * yz)
    angles = np.array([roll, math.atan2(-zx, math.hypot(zy, zz)), yaw])
    ET.SubElement(element, "origin", xyz=_text(at), rpy=_text(angles))


def _text(values: Vector | float) -> str:
    return " ".join(repr(float(each)) for each in np.atleast_1d(values))

"""MJCF files with what they include, as specifications that MuJoCo compiles.

Files come from strangers: they are read only near the first one, and elements that multiply others
are refused. Purely visual elements are removed, and meshes where no inertia depends on them.

Importing this module imports MuJoCo, so import it where it is used.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from itertools import count
from pathlib import Path
from typing import Any

from bus_schema.errors import RobotDescriptionError
from bus_schema.foreign_text import shortened
from bus_schema.mujoco_library import mujoco
from bus_schema.urdf.checks import check_depth
from bus_schema.urdf.packages import repository_of
from bus_schema.user_files import read_text

_DEEPEST = 200
_MOST_ELEMENTS = 5000  # MuJoCo's time grows with the square of their number: 1.5 s for 5000 bodies
_MOST_FILES, _MOST_BYTES = 2000, 500_000_000
_OPTIONS = ("gravity", "timestep", "actuatorgroupdisable")
_NO_TREE = ("deformable", "extension")
_MACROS = ("composite", "flexcomp", "replicate")
_ONLY_SEEN = {
    *("visual", "sensor", "contact", "keyframe", "size", "statistic", "custom"),
    *("camera", "light", "material", "texture", "hfield", "skin", "pair", "flag"),
}
_NOT_FINITE = re.compile(r"[+-]?(nan(\(.*\))?|inf(inity)?)", re.IGNORECASE)
_GEOM = mujoco.mjtGeom
_READ = {"include": (".xml", ".mjcf"), "model": (".xml", ".mjcf"),
         "mesh": (".stl", ".obj", ".msh")}  # fmt: skip
"""Elements that open files, and the suffixes of those."""
SHAPES = {
    _GEOM.mjGEOM_SPHERE: "sphere",
    _GEOM.mjGEOM_ELLIPSOID: "sphere",
    _GEOM.mjGEOM_BOX: "box",
    _GEOM.mjGEOM_CYLINDER: "cylinder",
    _GEOM.mjGEOM_CAPSULE: "cylinder",
}
"""The nearest URDF shape for each simple geom."""
HINGE_AND_SLIDE = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)


class MjcfFiles:
    """The files of an MJCF model, checked before MuJoCo opens any of them.

    Args:
        path: the first one.
        include: folders that may be read, besides its own and the one around it.

    Attributes:
        warnings: about parts that are left out.
    """

    def __init__(self, path: Path, include: Sequence[Path]) -> None:
        self.warnings: list[str] = []
        folder = path.resolve().parent
        around = [each for each in (folder.parent, *repository_of(path)) if each.parent != each]
        self._folders = [folder, *around, *include]
        self._read = self._read_bytes = 0

    def prepare(self, root: ET.Element, folder: Path, within: tuple[Path, ...] = ()) -> None:
        """Write the contents of included files into a model, and absolute paths of others.

        Args:
            root: the root element of a file; it is modified.
            folder: its folder.
            within: the attached models that this one is in, and itself.

        Raises:
            RobotDescriptionError: it opens other files, or multiplies elements.
        """
        self._include(root, folder, ())
        for found in (each for tag in _NO_TREE for part in root.findall(tag) for each in part):
            raise RobotDescriptionError(
                f"{_shown(found)}: must be left out, because only a tree of bodies can be emulated"
            )
        self.warnings += _sensor_delays(root)
        for parent in list(root.iter()):
            for child in list(parent):
                if child.tag in _ONLY_SEEN:
                    parent.remove(child)
        for option in root.findall("option"):  # old files have some that current MuJoCo refuses
            option.attrib = {key: text for key, text in option.attrib.items() if key in _OPTIONS}
        elements = list(root.iter())
        if len(elements) > _MOST_ELEMENTS:
            raise RobotDescriptionError(f"has {len(elements)} elements: at most {_MOST_ELEMENTS}")
        meshes = folder / _mesh_folder(root)
        for element in elements:
            if element.tag in _MACROS or ("file" in element.attrib and element.tag not in _READ):
                raise RobotDescriptionError(
                    f"{_shown(element)} is not supported: write its contents out"
                )
            for name, text in element.attrib.items():
                if any(_NOT_FINITE.fullmatch(part) for part in text.split()):
                    raise RobotDescriptionError(
                        f"{name} of {_shown(element)} is not a finite number"
                    )
            if element.tag == "mesh" and "file" in element.attrib:
                element.set("name", element.get("name") or Path(element.get("file", "")).stem)
                element.set("file", str(meshes / element.get("file", "")))
            elif element.tag == "model":
                if (file := self.allowed(element, folder)) in within:
                    raise RobotDescriptionError(f"{_shown(element)}: {file.name} attaches itself")
                # It is checked alone, MuJoCo reads it.
                self.prepare(parsed(file), file.parent, (*within, file))
                element.set("file", str(file))

    def _include(self, parent: ET.Element, folder: Path, within: tuple[Path, ...]) -> None:
        """Replace elements that include a file by its contents.

        Args:
            parent: the root element of a file.
            folder: the model's folder.
            within: the included files that this one is in, and itself.
        """
        check_depth(parent, _DEEPEST)
        for place in list(parent.iter()):
            for found in place.findall("include"):
                if (file := self.allowed(found, folder)) in within:
                    raise RobotDescriptionError(f"{_shown(found)}: {file.name} includes itself")
                content = parsed(file)
                self._include(content, folder, (*within, file))
                at = list(place).index(found)
                place[at : at + 1] = list(content)

    def allowed(self, element: ET.Element, folder: Path) -> Path:
        """Return the absolute path of the file that an element names.

        Raises:
            RobotDescriptionError: it must not be read, or is too large.
        """
        file = (folder / element.get("file", "")).resolve()
        if is_there := file.is_file():
            self._read, self._read_bytes = self._read + 1, self._read_bytes + file.stat().st_size
        if file.suffix.lower() not in _READ[element.tag] or not is_there:
            allowed = f"no such file; its name must end with {' or '.join(_READ[element.tag])}"
        elif not any(file.is_relative_to(each) for each in self._folders):
            allowed = f"must be below {self._folders[1]}, or a folder that --include names"
        elif self._read > _MOST_FILES or self._read_bytes > _MOST_BYTES:
            most = f"{_MOST_FILES} files, and {_MOST_BYTES // 1_000_000} MB"
            allowed = f"at most {most}, are read"
        else:
            return file
        raise RobotDescriptionError(f"{_shown(element)}: {allowed}")


def _sensor_delays(root: ET.Element) -> list[str]:
    """Return a warning about sensors that report late."""
    late = [
        f"{sensor.get('name') or sensor.tag} ({key} {sensor.get(key)} s)"
        for sensor in root.iterfind("sensor/*")
        for key in ("delay", "interval")
        if any(part not in ("0", "0.0") for part in sensor.get(key, "0").split())
    ]
    what = "left out; link.uplink.delay_ms delays what the controller learns of all joints"
    return [f"delays of sensors {shortened(', '.join(late))}: {what}"] if late else []


def parsed(file: Path) -> ET.Element:
    """Return the root element of a file.

    Raises:
        RobotDescriptionError: it cannot be read.
    """
    try:
        return ET.fromstring(read_text(file))
    except (OSError, ET.ParseError) as error:
        raise RobotDescriptionError(f"{file} cannot be read as MJCF: {error}") from error


def _mesh_folder(root: ET.Element) -> str:
    """Return the folder of mesh files, relative to the model's."""
    found = [compiler.attrib for compiler in root.findall("compiler")]
    return next((each[key] for key in ("meshdir", "assetdir") for each in found if key in each), "")


def one_element_a_line(root: ET.Element) -> str:
    """Write the n-th element on the n-th line, so that MuJoCo's errors identify it."""
    for element in root.iter():
        element.text = "\n" if len(element) else ""
        for child in element:
            child.tail = "\n" if child is not element[-1] else ""
    return ET.tostring(root, encoding="unicode")


def reason(error: Exception, root: ET.Element) -> str:
    """Return MuJoCo's reason, with the element concerned."""
    text = " ".join(str(error).removeprefix("XML ").removeprefix("Error: ").split())
    if (place := re.search(r" Element .*, line (\d+)$", text)) is None:
        return text
    return f"{text[: place.start()]}: {_shown(list(root.iter())[int(place[1]) - 1])}"


def _shown(element: ET.Element) -> str:
    """Return an element's opening tag."""
    inside = " ".join(f"{name}={text!r}" for name, text in element.attrib.items())
    return f"<{shortened(f'{element.tag} {inside}'.strip())}>"


def reduce_spec(spec: Any, files: MjcfFiles) -> list[str]:
    """Fix the base, delete other free bodies and what is only seen; name bodies and joints.

    Returns:
        Warnings about free bodies.

    Raises:
        RobotDescriptionError: a URDF cannot represent it, or a mesh must not be read.
    """
    warnings = _fix_base(spec)
    unnamed, needed = count(1), set()
    for body in spec.bodies:
        body.name = body.name or f"body_{next(unnamed)}"
        for index, joint in enumerate(body.joints, start=1):
            joint.name = joint.name or f"{body.name}_joint_{index}"
            if joint.type not in HINGE_AND_SLIDE:
                raise RobotDescriptionError(f"joint {shortened(joint.name)} must be hinge or slide")
        for geom in list(body.geoms):
            geom.material = ""
            if geom.meshname and _weighs(spec.compiler.inertiafromgeom, body, geom):
                needed.add(geom.meshname)
            elif geom.type not in SHAPES or geom.meshname:
                spec.delete(geom)
    for kind in ("sensors", "keys", "pairs", "excludes", "skins", "textures", "materials"):
        for each in list(getattr(spec, kind)):
            spec.delete(each)
    for mesh in list(spec.meshes):
        if mesh.name in needed:
            file = Path(mesh.file)
            files.allowed(ET.Element("mesh", file=file.name), file.parent)
        else:
            spec.delete(mesh)
    spec.compiler.fusestatic = spec.compiler.discardvisual = False
    spec.compiler.LRopt.mode = mujoco.mjtLRMode.mjLRMODE_NONE  # which would take long to simulate
    return warnings


def _fix_base(spec: Any) -> list[str]:
    """Delete free bodies beside an arm; without an arm, fix the one with most joints."""

    def joints_of(body: Any) -> int:
        return sum(joint.type in HINGE_AND_SLIDE for joint in body.joints) + sum(
            map(joints_of, body.bodies)
        )

    def free_joints(body: Any) -> list[Any]:
        return [each for each in body.joints if each.type == mujoco.mjtJoint.mjJNT_FREE]

    bodies, warnings = list(spec.worldbody.bodies), []
    free = [body for body in bodies if free_joints(body)]
    is_fixed = any(joints_of(body) for body in bodies if body not in free)
    base = max(free, key=joints_of, default=None)
    if base is not None and not is_fixed and not joints_of(base):
        shown = shortened(base.name) or "(unnamed)"
        raise RobotDescriptionError(
            f"body {shown} has a free joint: an arm must be fixed to the world"
        )
    for body in free:
        shown = f"body {shortened(body.name) or '(unnamed)'} is free, and"
        if body is base and not is_fixed:
            spec.delete(free_joints(body)[0])
            warnings.append(f"{shown} fixed to the world: only arms with a fixed base are emulated")
        else:
            spec.delete(body)
            warnings.append(f"{shown} left out")
    return warnings


def _weighs(by_geoms: Any, body: Any, geom: Any) -> bool:
    """Whether a geom adds to the inertia of a moving body."""
    mass = geom.density if math.isnan(geom.mass) else geom.mass
    if mass == 0.0 or by_geoms == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE:
        return False
    if body.explicitinertial and by_geoms == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO:
        return False
    carrier = body
    while carrier is not None and not carrier.joints:
        carrier = carrier.parent
    return carrier is not None

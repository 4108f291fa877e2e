"""Inertias of links for which a URDF gives none, estimated from their shapes.

Each shape is taken as a solid of one density, a mesh as its convex hull. A process of limited time
and memory reads the meshes, which come from strangers.
"""

from __future__ import annotations

import json
import re
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.errors import RobotDescriptionError
from bus_schema.runtime.limited_process import (
    LimitedProcess,
    LimitedProcessError,
    limit_this_process,
)
from bus_schema.urdf.checks import INERTIA, finite_number, inertia_of, joint_ends, mass_of
from bus_schema.urdf.link_tree import Frame, LinkTree, placed, rotated, turned
from bus_schema.urdf.resolved import mesh_file

MARK = "estimated"
"""Attribute of an estimated ``<inertial>``: what it is estimated from."""
_DENSITY_KG_M3 = 1000.0
_MOST_BYTES = 200_000_000
_THICKNESS, _TIP_SHARE, _LEAST_RADIUS_M = 0.15, 0.03, 0.01
"""Radius of a link without shapes: a share of its length, or for the last one of the arm's reach;
the least."""
_SIZES = {
    "box": ("size",), "sphere": ("radius",),
    "cylinder": ("radius", "length"), "capsule": ("radius", "length"),
}  # fmt: skip
_Solid = tuple[str, tuple[float | str, ...]]
"""Kind and sizes of a shape: numbers; for a mesh the file and its scale."""
_Shape = tuple[_Solid, Frame]
"""A solid, and where it is, seen from its link."""
_AT_LINK: Frame = (np.zeros(3), np.eye(3))


def estimate_inertias(
    root: ET.Element, base: Path, moving: set[str], include: Sequence[Path], mass_kg: float | None
) -> None:
    """Write inertias for moved links that have none.

    Args:
        root: the URDF, which passed `check_urdf`.
        base: its folder.
        moving: names of the joints that move.
        include: folders with packages that the user names.
        mass_kg: mass of the whole arm; None for the density of water.

    Raises:
        RobotDescriptionError: the mass cannot be spread.
    """
    tree = LinkTree(root)
    bare = _bare_groups(tree, moving, and_base=mass_kg is not None)
    shapes = {name: _shapes(tree, name, base, include) for names in bare for name in names}
    rods = {names[0]: _rod(tree, names, moving) for names in bare}
    solids = _solids([*_flat(shapes), *_flat(rods)])
    written = []
    for names in bare:
        found = {name: _whole(shapes[name], solids) for name in names}
        source = "their shapes"
        if not any(each is not None for each in found.values()):
            found, source = {names[0]: _whole(rods[names[0]], solids)}, "their lengths"
        for name, solid in found.items():
            written += [] if solid is None else [_write(tree.links[name], solid, source)]
    if mass_kg is not None:
        _spread(written, sum(map(mass_of, tree.links.values())), mass_kg)


def likely_moments(
    tree: LinkTree, names: Sequence[str], base: Path, moving: set[str], include: Sequence[Path]
) -> dict[str, Matrix]:
    """Return moments of inertia for each kg of some links, from their shapes or lengths, m².

    Args:
        tree: the URDF's links.
        names: the links.
        base: the URDF's folder.
        moving: names of the joints that move.
        include: folders with packages that the user names.

    Returns:
        Tensors about the centre of mass in the axes of each link, by its name.
    """
    shapes = {name: _shapes(tree, name, base, include) for name in names}
    rods = {name: _rod(tree, [name], moving) for name in names}
    solids = _solids([*_flat(shapes), *_flat(rods)])
    found = {}
    for name in names:
        whole = _whole(shapes[name], solids)
        whole = _whole(rods[name], solids) if whole is None else whole
        if whole is not None:
            found[name] = whole[4:].reshape(3, 3) / whole[0]
    return found


def estimated_links(root: ET.Element) -> str:
    """Describe the estimated inertias of a URDF; an empty text if there is none."""
    marked = [link for link in root.findall("link") if link.find(f"inertial[@{MARK}]") is not None]
    if not marked:
        return ""
    sources = sorted({each.get(MARK, "") for each in root.iterfind(f"link/inertial[@{MARK}]")})
    return (
        f"inertia of {len(marked)} links ESTIMATED from {' and '.join(sources)}:"
        f" {sum(map(mass_of, marked)):.4g} kg"
    )


def _bare_groups(tree: LinkTree, moving: set[str], *, and_base: bool) -> list[list[str]]:
    """Return the links that one joint moves together, where none of them has an inertia."""
    groups: dict[str | None, list[str]] = {}
    for name in tree.links:
        groups.setdefault(tree.mover(name, moving), []).append(name)
    for mover, names in list(groups.items()):
        links = [tree.links[name] for name in names]
        if any(mass_of(link) or any(inertia_of(link)) for link in links):
            del groups[mover]
    if not and_base or groups.keys() == {None}:
        groups.pop(None, None)
    return list(groups.values())


def _shapes(tree: LinkTree, name: str, base: Path, include: Sequence[Path]) -> list[_Shape]:
    """Return the collision shapes of a link, else its visual ones, as far as their files exist."""
    for kind in ("collision", "visual"):
        found = []
        for element in tree.links[name].findall(kind):
            solid = _named_solid(element.find("geometry/*"), name, base, include)
            found += [] if solid is None else [(solid, placed(_AT_LINK, element))]
        if found:
            return found
    return []


def _named_solid(
    shape: ET.Element | None, link: str, base: Path, include: Sequence[Path]
) -> _Solid | None:
    if shape is None:
        return None
    file, names = "", _SIZES.get(shape.tag, ())
    if shape.tag == "mesh":
        file = mesh_file(shape.get("filename", ""), base, include).removeprefix("file://")
        names = ("scale",)
        if not Path(file).is_file():
            return None
    texts = [part for each in names for part in shape.get(each, "1 1 1").split()]
    sizes = [finite_number(f"<{shape.tag}> of link {link}", "size", text) for text in texts]
    if len(sizes) != {"mesh": 3, "box": 3, "sphere": 1}.get(shape.tag, 2):
        return None
    return shape.tag, (file, *sizes) if file else tuple(sizes)


def _rod(tree: LinkTree, names: list[str], moving: set[str]) -> list[_Shape]:
    """Return a rod from the joint that moves some links to the farthest joint on them.

    It is a small ball where two joints meet in one point, and at the end of an arm.
    """
    at, turn = tree.frame(names[0])
    children = [c for c, joint in tree.joints.items() if joint.get("name") in moving]
    children = [child for child in children if joint_ends(tree.joints[child])[0] in names]
    ends = [rotated(turn.T, tree.frame(child)[0] - at) for child in children]
    end = max(ends, key=lambda each: float((each**2).sum()), default=np.zeros(3))
    length, reach = (float(np.sqrt((each**2).sum())) for each in (end, at))
    if length < 2.0 * _LEAST_RADIUS_M:
        radius = _LEAST_RADIUS_M if ends else max(_TIP_SHARE * reach, _LEAST_RADIUS_M)
        return [(("sphere", (radius,)), _AT_LINK)]
    z = end / length
    x = np.cross(z, np.eye(3)[np.abs(z).argmin()])
    x /= np.sqrt((x**2).sum())
    radius = max(_THICKNESS * length, _LEAST_RADIUS_M)
    frame = (0.5 * end, np.column_stack([x, np.cross(z, x), z]))
    return [(("cylinder", (radius, length)), frame)]


def _flat(shapes: Mapping[str, Iterable[_Shape]]) -> list[_Solid]:
    return [solid for each in shapes.values() for solid, _ in each]


def _whole(shapes: Sequence[_Shape], solids: Mapping[_Solid, Any]) -> Vector | None:
    """Return mass, centre (3) and moments (9) of shapes together, seen from their link."""
    known = [(solids[solid], frame) for solid, frame in shapes if solids.get(solid) is not None]
    if not known:
        return None
    volumes = np.array([volume for (volume, _, _), _ in known])
    places = np.array([at + rotated(turn, np.array(own)) for (_, own, _), (at, turn) in known])
    center = (volumes[:, None] * places).sum(axis=0) / volumes.sum()
    total = np.zeros((3, 3))
    for ((volume, _, own), (_, turn)), lever in zip(known, places - center, strict=True):
        far = (lever**2).sum() * np.eye(3) - np.outer(lever, lever)
        total += turned(np.array(own), turn) + volume * far
    mass = _DENSITY_KG_M3 * volumes.sum()
    return np.concatenate([[mass], center, _DENSITY_KG_M3 * total.ravel()]).round(12)


def _write(link: ET.Element, solid: Vector, source: str) -> ET.Element:
    """Write mass and inertia of a link, and return the element."""
    for old in link.findall("inertial"):
        link.remove(old)
    inertial = ET.SubElement(link, "inertial", {MARK: source})
    ET.SubElement(inertial, "origin", xyz=" ".join(f"{part:.6g}" for part in solid[1:4]))
    ET.SubElement(inertial, "mass", value=f"{solid[0]:.6g}")
    values = [f"{part:.6g}" for part in solid[4:].reshape(3, 3)[np.triu_indices(3)]]
    ET.SubElement(inertial, "inertia", dict(zip(INERTIA, values, strict=True)))
    return inertial


def _spread(written: Sequence[ET.Element], total_kg: float, mass_kg: float) -> None:
    """Scale estimated masses and inertias so that the whole arm has a mass."""
    estimated = sum(float(mass.get("value", "")) for each in written for mass in each.iter("mass"))
    given = total_kg - estimated
    if not written or mass_kg <= given:
        allowed = f"must be more than the {given:.4g} kg that the file gives"
        if not written:
            allowed = "must be left out, because the file gives the inertia of all moved links"
        raise RobotDescriptionError(f"robot.mass_kg = {mass_kg:g} (--mass): {allowed}")
    for element in (each for part in written for each in part if each.tag != "origin"):
        for name, text in element.attrib.items():
            element.set(name, f"{float(text) * (mass_kg - given) / estimated:.6g}")


def _solids(wanted: Sequence[_Solid]) -> dict[_Solid, Any]:
    """Return volume, centre and moments of solids of density 1; without those that have none."""
    files = [Path(str(sizes[0])) for kind, sizes in wanted if kind == "mesh"]
    if not wanted or sum(file.stat().st_size for file in set(files)) > _MOST_BYTES:
        return {}
    return _computed(tuple(dict.fromkeys(wanted)), tuple(file.stat().st_mtime_ns for file in files))


@lru_cache(maxsize=8)
def _computed(wanted: tuple[_Solid, ...], changed_ns: tuple[int, ...]) -> dict[_Solid, Any]:  # noqa: ARG001
    try:
        answer = LimitedProcess(__name__, json.dumps(wanted).encode()).answer()
    except LimitedProcessError as error:
        raise RobotDescriptionError(
            f"inertias cannot be estimated from its meshes: damaged, or too large ({error})"
        ) from error
    found = json.loads(answer.splitlines()[-1])
    return {solid: each for solid, each in zip(wanted, found, strict=True) if each is not None}


def main() -> None:
    """Compute the solids that standard input names."""
    limit_this_process(cpu_s=8)
    import coal

    print(json.dumps([_solid_here(coal, *each) for each in json.load(sys.stdin.buffer)]))


def _solid_here(coal: Any, kind: str, sizes: list[Any]) -> list[Any] | None:
    """Return volume, centre and moments of a solid of density 1; None if it has none."""
    try:
        if kind == "mesh":
            body = _hull(coal, Path(sizes[0]), np.array(sizes[1:]))
        else:
            body = getattr(coal, kind.capitalize())(*sizes)
        volume, center = float(body.computeVolume()), np.asarray(body.computeCOM())
        moments = np.asarray(body.computeMomentofInertiaRelatedToCOM())
    except (RuntimeError, ValueError):
        return None
    is_solid = volume > 1e-12 and np.isfinite(moments).all()
    return [volume, center.ravel().tolist(), moments.tolist()] if is_solid else None


def _hull(coal: Any, file: Path, scale: Vector) -> Any:
    """Return the convex hull of a mesh, in metres: Coal ignores the unit of a Collada file."""
    if file.suffix.lower() == ".dae":
        with file.open(encoding="utf-8", errors="replace") as stream:
            unit = re.search(r"<unit[^>]*\smeter=\s*[\"']([0-9.eE+-]+)[\"']", stream.read(10_000))
        scale = scale * float(unit[1] if unit else 1.0)
    mesh = coal.MeshLoader().load(str(file), scale)
    try:
        mesh.buildConvexHull(True, "Qt")
    except RuntimeError:  # many points in one plane; the next option moves each a little
        mesh.buildConvexHull(True, "QJ")
    return mesh.convex


if __name__ == "__main__":
    main()

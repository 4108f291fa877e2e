"""The text of a URDF or MJCF file, with slips that only strict readers refuse."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Iterator, Mapping
from heapq import heapify, heappop, heappush
from itertools import islice

from bus_schema.urdf.checks import MOST_LINKS, joint_ends, mass_of

_LIGHTEST_KG = 1e-5
_SHOWN = 8
_FIND = re.compile(r"^(?:file://)?\$\(find\s+([^\s)]+)\s*\)")
_PREFIX = re.compile(r"[<\s]([A-Za-z_]\w*):\w+[\s=>]")


def parsed(text: str) -> tuple[str, ET.Element]:
    """Return a file's text and root, with slips mended.

    Undeclared prefixes are declared, commas become spaces, and ``$(find PACKAGE)`` at the start of
    a mesh's file name becomes ``package://PACKAGE``.

    Raises:
        ParseError: it is no XML.
    """
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        if "unbound prefix" not in str(error):
            raise
        unknown = {each for each in _PREFIX.findall(text) if f"xmlns:{each}=" not in text}
        names = "".join(f' xmlns:{each}="{each}"' for each in sorted(unknown - {"xmlns", "xml"}))
        text = re.sub(r"<(robot|mujoco)\b", rf"<\1{names}", text, count=1)
        root = ET.fromstring(text)
    commas = [
        (each, name) for each in root.iter() for name in ("xyz", "rpy") if "," in each.get(name, "")
    ]
    for element, name in commas:
        element.set(name, element.get(name, "").replace(",", " "))
    found = [mesh for mesh in root.iter("mesh") if _FIND.match(mesh.get("filename", ""))]
    for mesh in found:
        mesh.set("filename", _FIND.sub(r"package://\1", mesh.get("filename", "")))
    return ET.tostring(root, encoding="unicode") if commas or found else text, root


def drop_frames(root: ET.Element) -> list[str]:
    """Drop fixed ends of a robot with too many links that weigh next to nothing.

    Those nearest to the base go first, such as the sensors of a mobile base.

    Returns:
        A warning, if there are such.
    """
    links = {link.get("name", ""): link for link in root.findall("link")}
    if (excess := len(root.findall("link")) - MOST_LINKS) <= 0:
        return []
    carriers = {joint_ends(joint)[1]: joint for joint in root.findall("joint")}
    dropped = list(islice(_light_ends(links, carriers), excess))
    gone = {id(element) for name in dropped for element in (links[name], carriers[name])}
    root[:] = [element for element in root if id(element) not in gone]
    shown = ", ".join(dropped[:_SHOWN]) + f" and {len(dropped) - _SHOWN} more" * (
        len(dropped) > _SHOWN
    )
    return [f"more than {MOST_LINKS} links: those without mass are left out: {shown}"] * bool(shown)


def _light_ends(
    links: Mapping[str, ET.Element], carriers: Mapping[str, ET.Element]
) -> Iterator[str]:
    """Return fixed links without mass that carry none, those nearest to the base first.

    A link may follow after all that it carries.
    """
    parents = {child: joint_ends(joint)[0] for child, joint in carriers.items()}
    carried = Counter(parents.values())
    light = {
        name
        for name, joint in carriers.items()
        if name in links and joint.get("type") == "fixed" and mass_of(links[name]) <= _LIGHTEST_KG
    }
    depths = _depths(parents)
    ends = [(depths.get(name, 0), number, name) for number, name in enumerate(links)
            if name in light and not carried[name]]  # fmt: skip
    heapify(ends)
    while ends:
        depth, number, name = heappop(ends)
        yield name
        parent = parents[name]
        carried[parent] -= 1
        if parent in light and not carried[parent]:
            heappush(ends, (depth - 1, number, parent))


def _depths(parents: Mapping[str, str]) -> dict[str, int]:
    """Return the number of joints between each link and the base."""
    carried: dict[str, list[str]] = {}
    for child, parent in parents.items():
        carried.setdefault(parent, []).append(child)
    depths = dict.fromkeys(carried.keys() - parents.keys(), 0)
    level = list(depths)
    while level:
        following = [(child, depths[link] + 1) for link in level for child in carried.get(link, ())]
        depths.update(following)
        level = [child for child, _ in following]
    return depths

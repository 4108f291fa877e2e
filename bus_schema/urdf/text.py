"""The text of a URDF or MJCF file, with slips that only strict readers refuse."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET

from bus_schema.urdf.checks import MOST_LINKS, joint_ends, mass_of

_LIGHTEST_KG = 1e-5
_PREFIX = re.compile(r"[<\s]([A-Za-z_]\w*):\w+[\s=>]")


def parsed(text: str) -> tuple[str, ET.Element]:
    """Return a file's text and root, with undeclared prefixes declared, and commas as spaces.

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
    return ET.tostring(root, encoding="unicode") if commas else text, root


def drop_frames(root: ET.Element) -> list[str]:
    """Drop fixed ends of a robot with too many links that weigh next to nothing.

    Those nearest to the base go first, such as the sensors of a mobile base.

    Returns:
        A warning, if there are such.
    """
    excess = len(links := root.findall("link")) - MOST_LINKS
    joints = {joint_ends(joint)[1]: joint for joint in root.findall("joint")}
    ends = [link for link in links if excess > 0 and _is_light_end(link, joints)]
    for link in (dropped := sorted(ends, key=lambda link: _depth(link, joints))[: max(excess, 0)]):
        root.remove(link)
        root.remove(joints[link.get("name", "")])
    names = ", ".join(link.get("name", "") for link in dropped)
    return [f"more than {MOST_LINKS} links: those without mass are left out: {names}"] * bool(names)


def _is_light_end(link: ET.Element, joints: dict[str, ET.Element]) -> bool:
    name = link.get("name", "")
    is_fixed = name in joints and joints[name].get("type") == "fixed"
    is_light = is_fixed and mass_of(link) <= _LIGHTEST_KG
    return is_light and all(joint_ends(joint)[0] != name for joint in joints.values())


def _depth(link: ET.Element, joints: dict[str, ET.Element]) -> int:
    name, depth = link.get("name", ""), 0
    while name in joints and depth <= len(joints):
        name, depth = joint_ends(joints[name])[0], depth + 1
    return depth

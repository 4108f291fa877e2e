"""Mutated URDF files: each is an arm that moves, or is refused with exit code 2's one error."""

from __future__ import annotations

import copy
import xml.etree.ElementTree as ET
from collections.abc import Callable
from functools import cache
from pathlib import Path

from mutation import Mutator

from deploy.run.simulate import simulate
from deploy.scenario.referenced_files import find_urdf
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError

_ARMS = ("paper_arm", "iiwa", "panda")
_VALUES = (
    "", "0", "-1", "1e308", "-1e308", "1e-308", "1e300", "nan", "inf", "-inf", "x", "0 0", "0 0 0",
    "1 0 0 0", "nan 0 0", "1e308 1e308 1e308", "0x10", "1,5", "1e9", "1e12", "1e-12", "0 0 1e-320",
    "9" * 5000, "world", "base", "revolute", "continuous", "fixed", "floating", "planar",
    "prismatic", "spherical", "../..", "package://x/y.stl", "file:///dev/zero", "\u202e", "%s%n",
    " ",
)  # fmt: skip
_TAGS = ("link", "joint", "inertial", "mass", "limit", "mimic", "x", "axis")
_SCENARIO = """
name: any_arm
duration_s: 0.05
rate_hz: 100
clock: lockstep
robot: {urdf: arm.urdf}
reference: {kind: joint_sinusoids, centre_rad: 0.3, terms: [{amplitude_rad: 0.1, frequency_rad_s: 1}]}
controller: {law: pid}
"""  # noqa: E501


@cache
def _source(arm: str) -> str:
    root = ET.fromstring(find_urdf(arm, Path()).read_text())
    for link in root.findall("link"):  # meshes take time to read, and are not ours
        for shape in (*link.findall("visual"), *link.findall("collision")):
            link.remove(shape)
    return ET.tostring(root, encoding="unicode")


def mutated_urdf(mutator: Mutator) -> str:
    """A shipped arm's URDF, mutated by its text or by its elements."""
    source = _source(mutator.choose(_ARMS))
    if mutator.chance(0.2):
        return mutator.text(source)
    if mutator.chance(0.02):
        deep = mutator.choose((1, 30, 3000, 100_000))
        return source.replace("</robot>", "<link>" * deep + "</link>" * deep + "</robot>")
    root = ET.fromstring(source)
    for _ in range(mutator.choose((1, 1, 2, 4))):
        mutator.choose(_WAYS)(mutator, root)
    return ET.tostring(root, encoding="unicode")


def try_urdf(mutator: Mutator, folder: Path) -> str:
    """Mutate an arm and move it; ``ran`` or ``refused``."""
    (folder / "arm.urdf").write_text(mutated_urdf(mutator), errors="surrogatepass")
    scenario = folder / "any_arm.yaml"
    scenario.write_text(_SCENARIO)
    try:
        setup = load_setup(str(scenario))
    except ScenarioError as error:
        assert str(scenario) in str(error), str(error)
        return "refused"
    simulate(setup)
    return "ran"


def _elements(root: ET.Element) -> list[ET.Element]:
    return [element for element in root.iter() if len(element)]


def _change_attribute(mutator: Mutator, root: ET.Element) -> None:
    having = [element for element in root.iter() if element.attrib]
    element = mutator.choose(having) if having else root
    name = mutator.choose([*element.attrib, "name"])
    element.set(name, mutator.choose(_VALUES))


def _swap_attribute(mutator: Mutator, root: ET.Element) -> None:
    """What another element has, such as another link's name: circles, twins and orphans."""
    element = mutator.choose([e for e in root.iter() if e.attrib] or [root])
    like = [e for e in root.iter() if set(e.attrib) & set(element.attrib)]
    if like:
        other = mutator.choose(like)
        name = mutator.choose(sorted(set(other.attrib) & set(element.attrib)))
        element.set(name, other.attrib[name])


def _drop_attribute(mutator: Mutator, root: ET.Element) -> None:
    having = [element for element in root.iter() if element.attrib]
    if having:
        element = mutator.choose(having)
        del element.attrib[mutator.choose(sorted(element.attrib))]


def _remove(mutator: Mutator, root: ET.Element) -> None:
    if len(root):
        parent = mutator.choose(_elements(root))
        parent.remove(mutator.choose(list(parent)))


def _repeat(mutator: Mutator, root: ET.Element) -> None:
    if len(root):
        parent = mutator.choose(_elements(root))
        for _ in range(mutator.choose((1, 2, 40))):
            parent.append(copy.deepcopy(mutator.choose(list(parent))))


def _move(mutator: Mutator, root: ET.Element) -> None:
    if len(root):
        parent = mutator.choose(_elements(root))
        element = mutator.choose(list(parent))
        mutator.choose(list(root.iter())).append(copy.deepcopy(element))
        parent.remove(element)


def _rename(mutator: Mutator, root: ET.Element) -> None:
    element = mutator.choose(list(root.iter()))
    element.tag = mutator.choose(_TAGS)


def _write(mutator: Mutator, root: ET.Element) -> None:
    mutator.choose(list(root.iter())).text = mutator.choose(_VALUES)


_WAYS: tuple[Callable[[Mutator, ET.Element], None], ...] = (
    _change_attribute, _change_attribute, _change_attribute, _swap_attribute, _swap_attribute,
    _drop_attribute, _remove, _repeat, _move, _rename, _write,
)  # fmt: skip

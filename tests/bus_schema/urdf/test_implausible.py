"""Masses, centres of mass and tips that no real arm has are named with their numbers."""

import xml.etree.ElementTree as ET

import pytest

from bus_schema.urdf.implausible import telescope_warnings, tip_warnings
from tests.bus_schema.urdf_texts import inertial, joint, two_links


def four_links(*masses, far="0.2", more=""):
    """Four joints in a row, 0.3 m apart; the last link's centre of mass is `far` from its frame."""
    own = [inertial(mass) for mass in masses]
    own[-1] = own[-1].replace("0.2 0 0", f"{far} 0 0")
    links = "".join(
        f'<link name="{n}">{each}</link>' for n, each in zip("de", own[2:], strict=True)
    )
    return two_links(
        b=own[0], c=own[1],
        more=links + joint("third", "c", "d") + joint("fourth", "d", "e") + more,
    )  # fmt: skip


def test_links_of_the_same_mass_are_named(load):
    (warned,) = load(four_links("2", "2", "2", "2")).warnings
    assert "all 4 moved links have the same mass: 2 kg" in warned
    assert not load(four_links("2", "2", "2", "1")).warnings
    assert not load(two_links()).warnings


def test_centre_of_mass_outside_of_its_link_is_named(load):
    (warned,) = load(four_links("3", "2", "2", "1", far="1.3")).warnings
    assert "centre of mass of link e is 1.3 m from its frame; the link is 0 m long" in warned
    assert "the arm 0.9 m" in warned
    assert not load(four_links("3", "2", "2", "1", far="0.4")).warnings


@pytest.mark.parametrize(
    ("tip", "kind", "is_warned"),
    [("finger", "fixed", True), ("wrist_camera", "fixed", True), ("x", "revolute", True),
     ("tool0", "fixed", False)],
)  # fmt: skip
def test_tip_that_is_a_finger_or_camera_is_named_with_the_flange(load, tip, kind, is_warned):
    end = f'<link name="{tip}"/>' + joint("end", "c", tip, kind)
    robot = load(two_links(more=end), ["first", "second"])
    warned = list(tip_warnings(ET.fromstring(robot.text), robot.tip_link, robot.joint_names))
    assert robot.tip_link == tip
    assert bool(warned) is is_warned
    assert all(f"is {tip}: a finger or sensor 0.3 m from c" in each for each in warned)


@pytest.mark.parametrize(
    ("axis", "is_warned"), [("0 1 0", True), ("0 -1 0", True), ("0 1 1", False)]
)
def test_stages_of_a_telescope_are_named(load, axis, is_warned):
    stages = joint("outer", "a", "b", "prismatic"), joint("inner", "b", "c", "prismatic", axis)
    robot = load(two_links(*stages))
    warned = list(telescope_warnings(ET.fromstring(robot.text), robot.joint_names))
    assert bool(warned) is is_warned
    assert all("outer, inner slide along one line: stages of a telescope" in w for w in warned)

"""Chains of a whole robot, of which one is driven."""

import xml.etree.ElementTree as ET

import pytest

from bus_schema.errors import RobotDescriptionError
from bus_schema.urdf.chains import chains_of, chosen_joints
from tests.bus_schema.urdf_texts import LIMIT, inertial, joint, two_links

ARM = ("one", "two", "three")


def arm(side, carrier, finger=""):
    """Three joints, each 0.3 m after the one before, and links of 2 kg."""
    text, before = "", carrier
    for name in (*ARM, *([finger] if finger else [])):
        text += f'<link name="{side}_{name}_link">{inertial()}</link>'
        text += joint(f"{side}_{name}", before, f"{side}_{name}_link")
        before = f"{side}_{name}_link"
    return text


def head(carrier):
    links = f'<link name="eye">{inertial()}</link><link name="neck">{inertial()}</link>'
    return links + joint("pan", carrier, "neck") + joint("tilt", "neck", "eye")


TWO_ARMS = two_links(more=arm("left", "c") + arm("right", "c", "wrist") + head("c"))


def names(side, *more):
    return tuple(f"{side}_{name}" for name in (*ARM, *more))


def chains(robot):
    return chains_of(ET.fromstring(robot.text), robot.joint_names)


def test_joints_that_carry_several_arms_belong_to_none(load):
    left, right, face = chains(load(TWO_ARMS))
    assert (left.tip, left.joints) == ("left_three_link", names("left"))
    assert (right.tip, right.joints) == ("right_wrist_link", names("right", "wrist"))
    assert (face.tip, face.joints) == ("eye", ("pan", "tilt"))
    assert left.reach_m == pytest.approx(0.6)  # from its first joint to its last link
    assert (left.mass_kg, right.mass_kg, face.mass_kg) == pytest.approx((6.0, 8.0, 4.0))


def test_arm_with_fingers_or_a_head_has_all_joints(load):
    finger = joint("finger", "c", "d", inside=LIMIT)
    robot = load(two_links(more=f'<link name="d">{inertial()}</link>{finger}' + head("b")))
    assert [each.joints for each in chains(robot)] == [
        ("first", "second", "finger"), ("first", "pan", "tilt"),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "joints"),
    [
        ("left_three_link", names("left")),
        ("left_two_link", names("left")[:2]),
        ("right", names("right", "wrist")),
        ("eye", ("pan", "tilt")),
    ],
)
def test_chain_is_chosen_by_a_link_or_by_names_of_its_joints(load, name, joints):
    robot = load(TWO_ARMS)
    chosen = chosen_joints(ET.fromstring(robot.text), robot.joint_names, name)
    assert tuple(chosen) == joints
    driven = load(TWO_ARMS, chosen)
    assert driven.joint_names == joints
    assert driven.tip_link in {"left_three_link", "right_wrist_link", "eye"}


@pytest.mark.parametrize("name", ["one", "lefft_three_link", "c_"])
def test_unknown_or_ambiguous_chain_is_refused_with_the_tips(load, name):
    robot = load(TWO_ARMS)
    with pytest.raises(RobotDescriptionError) as caught:
        chosen_joints(ET.fromstring(robot.text), robot.joint_names, name)
    assert f"--chain {name}: must be" in str(caught.value)
    assert "left_three_link, right_wrist_link, eye" in str(caught.value)

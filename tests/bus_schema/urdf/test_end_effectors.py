"""Which joints of a robot are its arm's: by what they move and carry, never by their names."""

import pytest

from bus_schema.robot_description import load_robot
from tests.bus_schema.urdf_texts import inertial

SYMMETRIC = '<limit effort="50" velocity="3" lower="-2" upper="2"/>'
SLIDES = '<limit effort="50" velocity="3" lower="0" upper="0.5"/>'


def part(name, carrier, kg, *, kind="revolute", at="0.15 0 0", axis="0 1 0", inside=SYMMETRIC):
    """A link of some mass, and the joint of the same name that moves it."""
    return f"""<link name="{name}_link">{inertial(kg, "0.001", "0.002", "0.002")}</link>
      <joint name="{name}" type="{kind}"><parent link="{carrier}"/><child link="{name}_link"/>
      <origin xyz="{at}"/><axis xyz="{axis}"/>{inside}</joint>"""


def row(prefix, count, carrier, kg):
    """Joints one after the other, 0.15 m apart, about y and x in turn."""
    links = [carrier, *(f"{prefix}{i}_link" for i in range(count))]
    axes = ("0 1 0", "1 0 0")
    return "".join(part(f"{prefix}{i}", links[i], kg, axis=axes[i % 2]) for i in range(count))


def robot(*parts):
    return f'<robot name="r"><link name="base"/>{"".join(parts)}</robot>'


@pytest.fixture
def read(tmp_path):
    def of(*parts):
        (tmp_path / "arm.urdf").write_text(robot(*parts))
        return load_robot(tmp_path / "arm.urdf", hold_grippers=True)

    return of


def held(arm):
    return {each.name: each.reason for each in arm.held}


@pytest.mark.parametrize("torso", [2, 4, 5])
@pytest.mark.parametrize("joints", [4, 6, 7])
def test_arms_on_a_torso_are_no_fingers_and_the_choice_is_offered(read, torso, joints):
    """Both arms weigh 0.27 of what the first joint moves, as light as fingers may be."""
    arms = [row(side, joints, f"t{torso - 1}_link", "0.3") for side in ("left", "right")]
    arm = read(row("t", torso, "base", "4"), *arms)
    assert not arm.held
    assert arm.joints == torso + 2 * joints
    (warning,) = [each for each in arm.warnings if "--chain TIP" in each]
    tips = f"left{joints - 1}_link, right{joints - 1}_link"
    assert f"2 chains side by side (tips {tips})" in warning


@pytest.mark.parametrize("fingers", [2, 3, 5])
def test_short_light_branches_behind_an_arm_are_fingers(read, fingers):
    names = [f"f{i}" for i in range(fingers)]
    hand = [
        part(name, "j5_link", "0.02", at="0.03 0 0")
        + part(f"{name}_tip", f"{name}_link", "0.01", at="0.03 0 0")
        for name in names
    ]
    arm = read(row("j", 6, "base", "1"), *hand)
    assert arm.joint_names == tuple(f"j{i}" for i in range(6))
    assert all(reason.startswith("of a hand") for reason in held(arm).values())
    assert len(arm.held) == 2 * fingers


def lift(*more):
    """A lift that carries an arm of three joints, beside wheels and a head on the base."""
    wheels = [
        part(name, "base", "1", kind="continuous", at="0 0.2 0") for name in ("right", "left")
    ]
    carried = part("extend", "lift_link", "1", kind="prismatic", axis="1 0 0", inside=SLIDES)
    return [
        *wheels,
        part("lift", "base", "2", kind="prismatic", axis="0 0 1", inside=SLIDES),
        carried,
        part("yaw", "extend_link", "0.3", axis="0 0 1"),
        part("head", "base", "0.5", at="0 0 1.2"),
        *more,
    ]


def test_lift_that_carries_the_arm_is_part_of_it(read):
    pitch = part("pitch", "yaw_link", "0.2")
    arm = read(*lift(pitch))
    assert arm.joint_names == ("lift", "extend", "yaw", "pitch")
    assert {name: why.split(" ")[0] for name, why in held(arm).items()} == dict.fromkeys(
        ("right", "left", "head"), "beside"
    )
    assert not any("--chain" in each for each in arm.warnings)


def test_wheels_and_a_head_are_held_beside_a_lift_with_few_joints_too(read):
    arm = read(*lift())
    assert arm.joint_names == ("lift", "extend", "yaw")
    assert set(held(arm)) == {"right", "left", "head"}


SLIDING = [
    part(name, "j4_link", "0.02", kind="prismatic", at="0.05 0 0", inside=inside)
    for name, inside in (("near", SLIDES), ("far", f'{SLIDES}<mimic joint="near"/>'))
]


@pytest.mark.parametrize(
    ("last", "why"),
    [
        (part("x", "j4_link", "0.004", kind="continuous", axis="1 0 0", at="0.04 0 0"),
         "a gripper's: moves little, about the axis of the joint before it"),
        (part("x", "j4_link", "0.3", inside=SYMMETRIC.replace('"-2"', '"-1.6"')
              .replace('"2"', '"0.03"')), "a gripper's jaw"),
        (part("x", "j4_link", "0.1", kind="prismatic", inside=SLIDES.replace("0.5", "0.08")),
         "a gripper's jaw"),
    ],
    ids=["propeller", "jaw", "sliding jaw"],
)  # fmt: skip
def test_light_last_joint_of_a_gripper_is_held(read, last, why):
    """Five joints of 1 kg; the fifth one turns about x."""
    roll = part("j4", "j3_link", "1", axis="1 0 0")
    arm = read(row("j", 4, "base", "1"), roll, last)
    assert arm.joint_names == tuple(f"j{i}" for i in range(5))
    assert held(arm)["x"].startswith(why)


def test_propeller_on_the_body_of_the_fingers_is_held_and_a_wrist_before_them_is_not(read):
    propeller = part("x", "j4_link", "0.004", kind="continuous", axis="0 0 1")
    arm = read(row("j", 5, "base", "1"), propeller, *SLIDING)
    assert arm.joint_names == tuple(f"j{i}" for i in range(5))
    assert "on the body that carries its fingers" in held(arm)["x"]
    wrist = part("j4", "j3_link", "0.02", axis="0 0 1")
    assert read(row("j", 4, "base", "1"), wrist, *SLIDING).joints == 5


@pytest.mark.parametrize("kind", ["revolute", "continuous"])
def test_light_flange_of_an_arm_is_driven(read, kind):
    """A UR10e's last joint moves 0.7 % of the mass, and those of Niryos 0.3 %."""
    flange = part("flange", "j4_link", "0.01", kind=kind, axis="0 0 1")
    assert read(row("j", 5, "base", "1"), flange).joint_names[-1] == "flange"


@pytest.mark.parametrize(
    "parts",
    [
        [part(name, "base", "1", kind="continuous") for name in ("left", "right")],
        [row(name, 6, "base", "1") for name in ("left", "right")],
    ],
    ids=["wheels", "legs"],
)
def test_robot_without_one_arm_has_the_sentence_with_the_option(read, parts):
    (warning,) = [each for each in read(*parts).warnings if "--chain TIP" in each]
    assert "2 chains side by side" in warning


def test_robot_with_nothing_but_fingers_says_which_and_how_to_drive_them(read):
    slides = [
        part(f"finger_of_the_gripper_number_{i}", "base", "0.1", kind="prismatic", inside=SLIDES)
        for i in range(2)
    ]
    with pytest.raises(Exception, match="has no joint to drive") as caught:
        read(*slides)
    message = str(caught.value)
    assert message.endswith(
        "finger_of_the_gripper_number_0, finger_of_the_gripper_number_1: a gripper's finger:"
        " slides beside another joint. --joints NAME,… (robot.joints) drives those that it names"
    )

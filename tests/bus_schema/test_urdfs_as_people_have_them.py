"""What URDFs get wrong: taken with a warning, or refused with file, element and what is allowed."""

from contextlib import closing

import numpy as np
import pytest

from bus_schema.errors import RobotDescriptionError
from bus_schema.robot_description import load_robot
from bus_schema.urdf import text
from bus_schema.urdf.checks import joint_ends
from controller.manipulator_model import ManipulatorModel
from plant_emulator.physics.engines import ENGINES
from tests.arms import INSTALLED, FreeArm, forward_dynamics
from tests.bus_schema.urdf_texts import LIMIT, inertial, joint, two_links


def resisting(damping, friction="0"):
    """The first joint with damping and friction."""
    more = f'<dynamics damping="{damping}" friction="{friction}"/>{LIMIT}'
    return two_links(joint("first", "a", "b", inside=more))


FIXED = two_links(joint("first", "a", "b", "fixed"), joint("second", "b", "c", "fixed"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("no XML at all", ("cannot be read as URDF",)),
        ("<sdf/>", ("root element is <sdf>",)),
        (FIXED, ("no revolute, continuous or prismatic joint",)),
        (two_links().replace('effort="5"', 'effort="strong"'), ("effort='strong' of joint first",)),
        (two_links().replace('lower="-1"', 'lower=""'), ("lower='' of joint first",)),
        (two_links().replace('upper="2"', 'upper="nan"'), ("upper='nan' of joint first",)),
        (two_links().replace('"second"', '"first"'), ("unique",)),
        (two_links().replace('name="second"', ""), ("unique and not empty",)),
        (two_links().replace('<child link="c"/>', ""), ("second lacks parent or child",)),
        (two_links(joint("first", "a", "b", axis="0 0 0")), ("0 0 0", "joint first", "0 0 1")),
        (two_links(joint("first", "a", "b", axis="0 1")), ("must be three numbers",)),
        (two_links(joint("first", "a", "b", "spherical")), ("one of revolute, continuous",)),
        (two_links(second=joint("second", "a", "b")), ("the child of more than one joint",)),
        (two_links(joint("first", "c", "b")), ("form a circle",)),
        (two_links(more='<link name="loose"/>'), ("one link must be the child",)),
        (two_links(second=joint("second", "nowhere", "c")), ("no link 'nowhere'",)),
        (two_links(more="<a>" * 100_000 + "</a>" * 100_000), ("must not be nested deeper",)),
        (two_links(b=inertial("1e300")), ("must be at most 1e",)),
        (two_links(b=inertial("1_0")), ("mass='1_0'", "link b", "finite number")),
        (resisting("nan"), ("damping='nan' of joint first", "finite number")),
        (resisting("1e300"), ("damping='1e300' of joint first", "must be at most 1e")),
        (resisting("-1"), ("damping='-1' of joint first", "must not be negative")),
        (resisting("0", "-0.2"), ("friction='-0.2' of joint first", "must not be negative")),
        (two_links(b=inertial().replace('<mass value="2"/>', "")), ("must have one mass",)),
        (two_links(b=inertial("${m}")), ("${m}", "<mass>", "xacro")),
        (two_links(b=inertial("nan")), ("mass='nan'", "link b", "finite")),
        (two_links(joint("%s%n", "a", "b")), ("'%s%n'", "<joint>", "must have no %")),
        (two_links(b=inertial("-2")), ("mass=-2", "link b", "negative")),
        (two_links(second=joint("second", "c", "c")), ("joint second", "itself", "two links")),
        (two_links(c=inertial(izz="0.4")), ("link c", "robot.repair", "joint second by 1.6e+02 %")),
        (
            two_links(joint("first", "a", "b", inside='<limit lower="1" upper="-1"/>')),
            ("joint first", "lower=1", "less than upper"),
        ),
        (
            two_links(
                joint("first", "a", "b", inside='<mimic joint="second"/>'),
                joint("second", "b", "c", inside='<mimic joint="first"/>'),
            ),
            ("first", "circle"),
        ),
    ],
)
def test_refused_with_file_element_and_what_is_allowed(load, tmp_path, text, message):
    with pytest.raises(RobotDescriptionError) as caught:
        load(text)
    for part in (str(tmp_path / "arm.urdf"), *message):
        assert part in str(caught.value)


@pytest.mark.parametrize("engine", INSTALLED)
def test_the_length_of_an_axis_changes_no_torque(engine, load):
    unit = load(two_links())
    long = load(two_links(joint("first", "a", "b", axis="0 2 0")))
    assert "axis of joint first" in long.warnings[0]
    q = np.array([0.3, -0.4])
    np.testing.assert_allclose(
        ManipulatorModel(long).gravity(q), ManipulatorModel(unit).gravity(q), rtol=1e-12
    )
    moved = []
    for robot in (unit, long):
        with closing(FreeArm(robot, engine)) as arm:
            arm.push(np.array([3.0, 1.0]))
            moved.append(arm.velocity.copy())
    np.testing.assert_allclose(moved[1], moved[0], rtol=1e-12)


@pytest.mark.parametrize("engine", INSTALLED)
@pytest.mark.parametrize(("izz", "repair"), [("0.055", False), ("0.2", True)])
def test_impossible_inertias_are_repaired_for_every_engine_with_a_warning(
    engine, load, izz, repair
):
    robot = load(two_links(b=inertial(izz=izz)), repair=repair)
    assert "link b breaks the triangle rule" in robot.warnings[0]
    with closing(FreeArm(robot, engine)) as arm:
        inertia = arm.mass_matrix(np.zeros(2))
    expected = ManipulatorModel(robot).mass_matrix(np.zeros(2))
    np.testing.assert_allclose(inertia, expected, atol=1e-10)
    lacking = float(izz) - 0.02 - 0.03  # half of it goes to iyy, about which the joint turns
    mended = ManipulatorModel(load(two_links())).mass_matrix(np.zeros(2))[0, 0] + lacking / 2
    assert inertia[0, 0] == pytest.approx(mended, abs=1e-8)


def test_inertia_without_mass_causes_a_warning(load):
    """As two links of pybullet_data's panda have it."""
    empty = inertial().replace('<mass value="2"/>', '<mass value="0"/>')
    third = joint("mount", "b", "c", "fixed")
    robot = load(two_links(second=third, c=empty))
    assert [text for text in robot.warnings if text.startswith("c: inertia without mass")]
    assert not load(two_links()).warnings


@pytest.mark.parametrize("name", ["package://some_robot/arm.stl", "arm.step"])
def test_meshes_that_are_not_there_cost_one_line(load, name):
    shape = f'<visual><geometry><mesh filename="{name}"/></geometry></visual>'
    robot = load(two_links(a=shape, b=inertial() + shape + shape.replace("visual", "collision")))
    (text,) = robot.warnings
    assert "mesh" in text
    assert name in text
    if "bullet" in INSTALLED:
        from plant_emulator.physics.bullet.camera import ArmCamera

        with closing(ArmCamera(robot)) as camera:
            assert camera.render(np.zeros(2), 40, 30).shape == (30, 40, 3)


def test_package_of_a_mesh_may_be_named_as_in_xacro(load, tmp_path):
    folder = tmp_path / "some_description"
    (folder / "meshes").mkdir(parents=True)
    (folder / "package.xml").write_text("<package><name>some_description</name></package>")
    (folder / "meshes/b.stl").write_text("solid b\nendsolid b\n")
    name = "$(find some_description)/meshes/b.stl"
    shape = f'<visual><geometry><mesh filename="{name}"/></geometry></visual>'
    robot = load(two_links(b=inertial() + shape))
    assert str(folder / "meshes/b.stl") in robot.resolved_urdf()
    assert not robot.warnings
    with pytest.raises(RobotDescriptionError, match="which xacro has not expanded"):
        load(two_links(b=inertial("$(find mass)")))


@pytest.mark.parametrize("engine", INSTALLED)
def test_physics_reads_no_mesh(engine, load, tmp_path):
    (tmp_path / "broken.obj").write_text("f 1 2 3\n")  # of which Bullet's reader dies
    shape = '<collision><geometry><mesh filename="broken.obj"/></geometry></collision>'
    robot = load(two_links(b=inertial() + shape))
    ENGINES[engine].arm_type.check(robot, 0.0, gui=False)
    ManipulatorModel(robot)


def test_fingers_are_held_and_a_lone_slide_is_driven(load):
    finger = joint("finger", "a", "c", "prismatic")
    held = load(two_links(second=finger))
    assert held.joint_names == ("first",)
    assert [each.name for each in held.held] == ["finger"]
    assert "finger" in held.held[0].reason
    alone = load(two_links(second=joint("slide", "b", "c", "prismatic")))
    assert alone.joint_names == ("first", "slide")
    assert alone.slides == (False, True)
    chosen = load(two_links(second=finger), ["finger"])
    assert chosen.joint_names == ("finger",)
    assert chosen.held[0].reason == "not among robot.joints"
    with pytest.raises(RobotDescriptionError, match=r"some of first, finger; not 'thumb'"):
        load(two_links(second=finger), ["thumb"])


def test_followers_of_held_joints_are_held(load):
    mimic = joint("second", "b", "c", inside=f'{LIMIT}<mimic joint="first" multiplier="2"/>')
    robot = load(two_links(second=mimic))
    assert robot.joint_names == ("first",)
    assert [(each.name, each.multiplier) for each in robot.followers] == [("second", 2.0)]
    with pytest.raises(RobotDescriptionError, match="some of first; not 'second'"):
        load(two_links(second=mimic), ["second"])


@pytest.mark.parametrize("engine", INSTALLED)
@pytest.mark.parametrize("links", [127, 128])
def test_as_many_links_as_bullet_answers_for(engine, load, links):
    more = "".join(
        f'<link name="more{i}">{inertial()}</link>{joint(f"j{i}", "c", f"more{i}", "fixed")}'
        for i in range(links - 3)
    )
    text = two_links(more=more).replace("\n", " ")  # on one line
    if links > 127:
        with pytest.raises(RobotDescriptionError, match="has 128 links; there must be 1 to 127"):
            load(text)
    else:
        robot = load(text)
        with closing(FreeArm(robot, engine, payload_kg=1.0)) as arm:
            arm.push(np.zeros(2))


def test_limit_of_a_held_joint_need_not_be_whole(load):
    """urdfdom refuses one without effort or velocity, for any type of joint."""
    partial = joint("second", "b", "c", inside='<limit lower="-1" upper="2"/>')
    robot = load(two_links(second=partial), ["first"])
    assert ManipulatorModel(robot).joints == 1


SAME = [
    ('<mass value="2"/>', '<mass value=" 2 "/>'),
    ('ixx="0.02"', 'ixx=" 0.02\n"'),
    ('xyz="0.2 0 0"', 'xyz=" 0.2  0 0 "'),
    (' ixy="0" ixz="0" iyz="0"', ""),
    ('effort="5"', 'effort="-1"'),
    ('effort="5"', 'effort="5 "'),
    ('velocity="3"', 'velocity="-1"'),
    ("</robot>", '<mujoco><compiler fusestatic="true" meshdir="x"/></mujoco></robot>'),
    ("</robot>", '<gazebo reference="b"/><ros2_control><joint name="a"/></ros2_control></robot>'),
    ('<robot name="test">', "<robot>"),
    ("<limit", '<dynamics damping="" friction="x"/><safety_controller k_velocity=""/><limit'),
]


@pytest.mark.parametrize(("old", "new"), SAME)
@pytest.mark.parametrize("engine", INSTALLED)
def test_controller_and_plant_read_the_same_arm_from_untidy_text(engine, load, old, new):
    """urdfdom drops the mass of a link that has a space after a number."""
    position = np.array([0.3, -0.4])
    plain = ManipulatorModel(load(two_links())).mass_matrix(position)
    robot = load(two_links().replace(old, new))
    np.testing.assert_array_equal(ManipulatorModel(robot).mass_matrix(position), plain)
    with closing(FreeArm(robot, engine)) as arm:
        np.testing.assert_allclose(arm.mass_matrix(position), plain, atol=1e-10)


STANDS = '<limit effort="5" velocity="3" lower="0" upper="0.0"/>'


def test_joint_with_an_empty_range_is_held_unless_all_have_one(load):
    robot = load(two_links(second=joint("second", "b", "c", inside=STANDS)))
    assert [(each.name, each.reason) for each in robot.held] == [("second", "its range is 0 … 0")]
    ends = joint("first", "a", "b", inside=STANDS), joint("second", "b", "c", inside=STANDS)
    robot = load(two_links(*ends))
    assert np.isinf(robot.upper_rad).all()
    assert "taken as unknown" in robot.warnings[0]
    assert load_robot(robot.path).text == robot.text


def test_joint_that_mimics_none_that_moves_is_held(load):
    follower = joint("second", "b", "c", inside=f'{LIMIT}<mimic joint="third"/>')
    (held,) = load(two_links(second=follower)).held
    assert held.reason == "mimics third, which does not move"


def test_gripper_whose_fingers_mimic_each_other_is_held_in_a_first_scenario(load):
    leader = joint("left", "c", "d")
    follower = joint("right", "c", "e", inside=f'{LIMIT}<mimic joint="left"/>')
    links = "".join(f'<link name="{name}">{inertial()}</link>' for name in "de")
    robot = load(two_links(more=links + leader + follower), hold_grippers=True)
    assert robot.reading == {"joints": ["first", "second"]}
    assert [each.name for each in robot.held] == ["left", "right"]
    assert load(robot.path.read_text()).joint_names == ("first", "second", "left")
    assert load(robot.path.read_text(), ["first", "left"]).followers[0].name == "right"


def arm_with(*ends, jaw="0.1", limit='<limit effort="5" velocity="3" lower="-0.1" upper="1.5"/>'):
    """Four joints in a row, and joints of the last link."""
    names = ["d", "e", *(f"f{i}" for i in range(len(ends)))]
    masses = ["2", "2", *(jaw for _ in ends)]
    links = "".join(
        f'<link name="{name}">{inertial(mass)}</link>'
        for name, mass in zip(names, masses, strict=True)
    )
    more = joint("third", "c", "d") + joint("fourth", "d", "e")
    more += "".join(joint(end, "e", f"f{i}", inside=limit) for i, end in enumerate(ends))
    return two_links(more=links + more)


def test_one_light_jaw_that_opens_to_one_side_is_held(load):
    (held,) = load(arm_with("x"), hold_grippers=True).held
    assert (held.name, held.reason[:15]) == ("x", "a gripper's jaw")
    assert load(arm_with("x")).joints == 5
    for wrist in (arm_with("x", jaw="2"), arm_with("x", limit=LIMIT)):
        assert load(wrist, hold_grippers=True).joints == 5


def test_light_fingers_behind_an_arm_are_held(load):
    robot = load(arm_with("x", "y", limit=LIMIT), hold_grippers=True)
    assert [each.name for each in robot.held] == ["x", "y"]
    assert robot.reading == {"joints": ["first", "second", "third", "fourth"]}
    assert load(arm_with("x", "y", jaw="4"), hold_grippers=True).joints == 6


def test_linkage_that_carries_a_further_joint_is_driven(load):
    follower = joint("link", "b", "d", inside=f'{LIMIT}<mimic joint="first"/>')
    wrist = joint("wrist", "d", "e")
    links = "".join(f'<link name="{name}">{inertial()}</link>' for name in "de")
    robot = load(two_links(more=links + follower + wrist), hold_grippers=True)
    assert robot.joint_names == ("first", "second", "wrist")


@pytest.mark.parametrize("engine", INSTALLED)
@pytest.mark.parametrize("izz", ["0.05000000000001", "0.0500001"])
def test_last_digit_of_a_rounded_inertia_matters_to_no_engine(engine, load, izz):
    """MuJoCo refuses a largest moment that exceeds the sum of the others by 1e-13."""
    robot = load(two_links(c=inertial(izz=izz)))
    assert not robot.warnings
    with closing(FreeArm(robot, engine)) as arm:
        expected = ManipulatorModel(robot).mass_matrix(np.zeros(2))
        np.testing.assert_allclose(arm.mass_matrix(np.zeros(2)), expected, atol=1e-10)


@pytest.mark.parametrize("engine", INSTALLED)
@pytest.mark.parametrize(
    "moments",
    [
        ("1.09317111513898E-07", "1.10835075609816E-15", "1.09317110675672E-07"),
        ("0", "0.02", "0.02"),  # an ideal rod
    ],
)
def test_needle_thinner_than_mujoco_takes_is_read_by_every_engine(engine, load, moments):
    needle = inertial("0.003", *moments).replace('ixy="0"', 'ixy="-9.31929125413026E-13"')
    mount = joint("mount", "c", "d", "fixed")
    robot = load(two_links(more=f'<link name="d">{needle}</link>{mount}'))
    assert not robot.warnings
    with closing(FreeArm(robot, engine)) as arm:
        expected = ManipulatorModel(robot).mass_matrix(np.zeros(2))
        np.testing.assert_allclose(arm.mass_matrix(np.zeros(2)), expected, atol=1e-10)


@pytest.mark.parametrize("engine", INSTALLED)
def test_moments_of_almost_nothing_and_axes_without_direction_are_read(engine, load):
    frame = inertial("1e-7", "3e-22", "3e-22", "5e-22")
    mount = joint("mount", "c", "d", "fixed", inside="").replace('xyz="0 1 0"', "")
    turn = joint("second", "b", "c").replace('<axis xyz="0 1 0"/>', "<axis/>")
    robot = load(two_links(second=turn, more=f'<link name="d">{frame}</link>{mount}'))
    with closing(FreeArm(robot, engine)) as arm:
        expected = ManipulatorModel(robot).mass_matrix(np.zeros(2))
        np.testing.assert_allclose(arm.mass_matrix(np.zeros(2)), expected, atol=1e-10)


def test_wheels_and_a_head_beside_an_arm_are_held(load, tmp_path):
    head = f'<link name="d">{inertial()}</link><link name="e">{inertial()}</link>'
    head += joint("third", "c", "d") + joint("fourth", "d", "e")
    sides = "".join(
        f'<link name="{name}_link">{inertial()}</link>' + joint(name, "a", f"{name}_link", kind)
        for name, kind in (("wheel", "continuous"), ("neck", "revolute"))
    )
    (tmp_path / "whole.urdf").write_text(two_links(more=head + sides))
    robot = load_robot(tmp_path / "whole.urdf", hold_grippers=True)
    assert robot.joint_names == ("first", "second", "third", "fourth")
    assert all("beside the arm, such as a wheel" in each.reason for each in robot.held)
    assert load(two_links(more=head + sides)).joints == 6  # scenarios drive what they drove


def test_undeclared_prefixes_and_commas_are_read(load):
    text = two_links().replace("<axis", "<axis drake:kind='x'")
    robot = load(text.replace('xyz="0.3 0 0"', 'xyz="0.3, 0, 0"'))
    position = np.array([0.4, -0.7])
    gravity = ManipulatorModel(load(two_links())).gravity(position)
    np.testing.assert_array_equal(ManipulatorModel(robot).gravity(position), gravity)


@pytest.mark.parametrize("engine", INSTALLED)
def test_point_of_mass_between_two_joints_is_taken_by_every_engine(engine, load):
    point = '<inertial><mass value="0.1"/><inertia ixx="0" iyy="0" izz="0"/></inertial>'
    robot, still = load(two_links(b=point)), np.zeros(2)
    expected = forward_dynamics(ManipulatorModel(robot), still, still, still)
    with closing(FreeArm(robot, engine, 1e-4)) as arm:
        np.testing.assert_allclose(arm.acceleration(still, still), expected, rtol=1e-2)


def test_robot_with_too_many_links_loses_light_ends_near_its_base(load):
    frames = "".join(
        f'<link name="f{n}"/>' + joint(f"j{n}", "c" if n else "a", f"f{n}", "fixed", inside="")
        for n in range(126)
    )
    robot = load(two_links(more=frames))
    assert robot.resolved_urdf().count("<link ") == 127
    assert any("without mass are left out: f0, f1" in each for each in robot.warnings)
    assert 'name="f0"' not in robot.text


@pytest.mark.parametrize("is_chain", [False, True])
def test_thousands_of_frames_are_dropped_in_linear_time(load, monkeypatch, is_chain):
    calls = 0

    def counted(element):
        nonlocal calls
        calls += 1
        return joint_ends(element)

    monkeypatch.setattr(text, "joint_ends", counted)
    frames = "".join(
        f'<link name="f{n}"/>'
        + joint(f"j{n}", f"f{n - 1}" if is_chain and n else "c", f"f{n}", "fixed", inside="")
        for n in range(3000)
    )
    robot = load(two_links(more=frames))
    assert robot.resolved_urdf().count("<link ") == 127
    assert calls <= 3 * 3002
    (warning,) = robot.warnings
    assert len(warning) < 300

"""What URDFs get wrong: taken with a warning, or refused with file, element and what is allowed."""

from contextlib import closing

import numpy as np
import pytest

from bus_schema.errors import RobotDescriptionError
from controller.manipulator_model import ManipulatorModel
from plant_emulator.physics.engines import ENGINES
from tests.arms import INSTALLED, FreeArm
from tests.bus_schema.urdf_texts import LIMIT, inertial, joint, two_links

FIXED = two_links(joint("first", "a", "b", "fixed"), joint("second", "b", "c", "fixed"))


@pytest.mark.parametrize(
    ("text", "told"),
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
        (two_links(c=""), ("link c", "joint second", "no inertia", "<inertial>")),
        (two_links(b=inertial("0", "0", "0", "0")), ("link b", "joint first", "no inertia")),
        (two_links(joint("first", "a", "b", axis="0 0 0")), ("0 0 0", "joint first", "0 0 1")),
        (two_links(joint("first", "a", "b", axis="0 1")), ("must be three numbers",)),
        (two_links(joint("first", "a", "b", "spherical")), ("one of revolute, continuous",)),
        (two_links(second=joint("second", "a", "b")), ("the child of more than one joint",)),
        (two_links(joint("first", "c", "b")), ("form a circle",)),
        (two_links(more='<link name="loose"/>'), ("one link must be the child",)),
        (two_links(second=joint("second", "nowhere", "c")), ("no link 'nowhere'",)),
        (two_links(more="<a>" * 100_000 + "</a>" * 100_000), ("must not be nested deeper",)),
        (two_links(b=inertial("1e300")), ("must be at most 1e",)),
        (two_links(b=inertial().replace('<mass value="2"/>', "")), ("must have one mass",)),
        (two_links(b=inertial("${m}")), ("${m}", "<mass>", "xacro")),
        (two_links(b=inertial("nan")), ("mass='nan'", "link b", "finite")),
        (two_links(joint("%s%n", "a", "b")), ("'%s%n'", "<joint>", "must have no %")),
        (two_links(b=inertial("-2")), ("mass=-2", "link b", "negative")),
        (two_links(second=joint("second", "c", "c")), ("joint second", "itself", "two links")),
        (two_links(b=inertial(izz="0.09")), ("link b", "robot.repair")),
        (
            two_links(joint("first", "a", "b", inside='<limit lower="1" upper="-1"/>')),
            ("joint first", "lower=1", "less than upper"),
        ),
        (
            two_links(second=joint("second", "b", "c", inside='<mimic joint="third"/>')),
            ("joint second", "'third'", "must be a joint"),
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
def test_refused_with_file_element_and_what_is_allowed(load, tmp_path, text, told):
    with pytest.raises(RobotDescriptionError) as caught:
        load(text)
    for part in (str(tmp_path / "arm.urdf"), *told):
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
    assert [said for said in robot.warnings if said.startswith("c: inertia without mass")]
    assert not load(two_links()).warnings


@pytest.mark.parametrize("name", ["package://some_robot/arm.stl", "arm.step"])
def test_meshes_that_are_not_there_cost_one_line(load, name):
    shape = f'<visual><geometry><mesh filename="{name}"/></geometry></visual>'
    robot = load(two_links(a=shape, b=inertial() + shape + shape.replace("visual", "collision")))
    (said,) = robot.warnings
    assert "mesh" in said
    assert name in said
    pytest.importorskip("pybullet")
    from plant_emulator.physics.bullet.camera import ArmCamera

    with closing(ArmCamera(robot)) as camera:
        assert camera.render(np.zeros(2), 40, 30).shape == (30, 40, 3)


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
    """urdfdom refuses one without effort or velocity, whatever the joint's type."""
    partial = joint("second", "b", "c", inside='<limit lower="-1" upper="2"/>')
    robot = load(two_links(second=partial), ["first"])
    assert ManipulatorModel(robot).joints == 1

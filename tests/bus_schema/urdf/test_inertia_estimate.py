"""Inertias that a file does not give are estimated from shapes, and those are marked."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest

from bus_schema.errors import RobotDescriptionError
from bus_schema.robot_description import load_robot
from bus_schema.urdf.checks import inertia_of, mass_of
from controller.manipulator_model import ManipulatorModel
from deploy.cli.robot import at_rest
from deploy.judge.conditions import conditions_of_runs
from deploy.scenario.checking.warnings import scenario_warnings
from deploy.scenario.effective import write_scenario
from deploy.scenario.scenario import load_setup
from deploy.scenario.starter import starter_scenario
from tests.bus_schema.urdf_texts import inertial, joint, two_links

BOX = '<box size="0.4 0.1 0.2"/>'
CORNERS = [[x, y, z] for x in (0.0, 0.4) for y in (-0.05, 0.05) for z in (-0.1, 0.1)]


def shape(geometry, kind="collision", xyz="0.2 0 0", rpy="0 0 0"):
    origin = f'<origin xyz="{xyz}" rpy="{rpy}"/>'
    return f"<{kind}>{origin}<geometry>{geometry}</geometry></{kind}>"


def write_mesh(file, points):
    """Write points as an STL mesh, in which each is a corner of a flat triangle's edge."""
    lines = ["solid box"]
    for three in zip(points, points[1:], points[2:], strict=False):
        corners = [f"vertex {x} {y} {z}" for x, y, z in three]
        lines += ["facet normal 0 0 1", "outer loop", *corners, "endloop", "endfacet"]
    file.write_text("\n".join([*lines, "endsolid box", ""]))


def write_collada(file, points, unit):
    """Write points as a Collada mesh, whose unit has a length in metres."""
    numbers = " ".join(f"{part / unit:.9g}" for point in points for part in point)
    corners = " ".join(f"{i} {i + 1} {i + 2}" for i in range(len(points) - 2))
    file.write_text(f'''<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="own" meter="{unit}"/><up_axis>Z_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="a" count="{3 * len(points)}">{numbers}</float_array>
<technique_common><accessor source="#a" count="{len(points)}" stride="3"><param name="X"
type="float"/><param name="Y" type="float"/><param name="Z" type="float"/></accessor>
</technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="{len(points) - 2}"><input semantic="VERTEX" source="#v" offset="0"/>
<p>{corners}</p></triangles></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node><instance_geometry url="#g"/></node>
</visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>
''')


def link_of(robot, name):
    (found,) = (x for x in ET.fromstring(robot.text).findall("link") if x.get("name") == name)
    return found


X2, Y2, Z2 = 0.4**2, 0.1**2, 0.2**2
BOX_INERTIA = [8 * (Y2 + Z2) / 12, 0, 0, 8 * (X2 + Z2) / 12, 0, 8 * (X2 + Y2) / 12]


@pytest.mark.parametrize(
    ("geometry", "mass", "ixx"),
    [
        (BOX, 8.0, BOX_INERTIA[0]),
        ('<cylinder radius="0.1" length="0.3"/>', 3 * np.pi, 1.5 * np.pi * 0.01 * (0.5 + 1.5)),
        ('<sphere radius="0.1"/>', 4 / 3 * np.pi, 0.4 * 4 / 3 * np.pi * 0.01),
        ('<mesh filename="box.stl"/>', 8.0, BOX_INERTIA[0]),
        ('<mesh filename="large.stl" scale="0.001 0.001 0.001"/>', 8.0, BOX_INERTIA[0]),
        ('<mesh filename="mm.dae"/>', 8.0, BOX_INERTIA[0]),
        ('<mesh filename="package://some/box.stl"/>', 8.0, BOX_INERTIA[0]),
    ],
)
def test_links_without_inertia_weigh_what_shapes_displace(load, tmp_path, geometry, mass, ixx):
    write_mesh(tmp_path / "box.stl", np.array(CORNERS) - [0.2, 0, 0])
    write_collada(tmp_path / "mm.dae", np.array(CORNERS) - [0.2, 0, 0], 0.001)
    write_mesh(tmp_path / "large.stl", 1000 * (np.array(CORNERS) - [0.2, 0, 0]))
    robot = load(two_links(b=shape(geometry)))
    link = link_of(robot, "b")
    assert mass_of(link) == pytest.approx(mass, rel=1e-5)
    assert inertia_of(link)[0] == pytest.approx(ixx, rel=1e-5)
    assert list(map(float, link.find("inertial/origin").get("xyz").split())) == [0.2, 0.0, 0.0]
    assert f"inertia of 1 links ESTIMATED from their shapes: {mass:.4g} kg" in robot.estimated


def test_several_turned_shapes_are_one_body_like_the_box_that_they_form(load):
    halves = [
        shape('<box size="0.1 0.2 0.2"/>', xyz=f"{x} 0 0", rpy="0 0 1.5707963267948966")
        for x in ("0.1", "0.3")
    ]
    link = link_of(load(two_links(b="".join(halves))), "b")
    assert mass_of(link) == pytest.approx(8.0)
    np.testing.assert_allclose(inertia_of(link), BOX_INERTIA, rtol=1e-5, atol=1e-12)


def test_collision_shapes_count_before_visual_ones_as_far_as_their_files_exist(load):
    box, missing = shape(BOX, "visual"), shape('<mesh filename="nowhere.stl"/>')
    assert mass_of(link_of(load(two_links(b=box + missing)), "b")) == pytest.approx(8.0)
    ball = shape('<sphere radius="0.1"/>')
    assert mass_of(link_of(load(two_links(b=box + ball)), "b")) == pytest.approx(4 / 3 * np.pi)


@pytest.mark.parametrize("content", ["", "solid\nendsolid", "no mesh", "\0" * 500])
def test_links_without_usable_shapes_are_rods_as_long_as_to_the_next_joint(load, tmp_path, content):
    (tmp_path / "bad.stl").write_text(content)
    robot = load(two_links(b=shape('<mesh filename="bad.stl"/>') if content else "", c=""))
    rod = link_of(robot, "b")  # 0.3 m to the next joint, of a radius of 0.15 of that
    assert mass_of(rod) == pytest.approx(1000 * np.pi * 0.045**2 * 0.3, rel=1e-5)
    assert rod.find("inertial/origin").get("xyz") == "0.15 0 0"
    tip = link_of(robot, "c")  # a ball, of a radius of 0.03 of the reach of 0.6 m
    assert mass_of(tip) == pytest.approx(1000 * 4 / 3 * np.pi * 0.018**3, rel=1e-5)
    assert "ESTIMATED from their lengths" in robot.estimated


def test_given_inertias_and_links_that_stand_are_left_as_they_are(load):
    given = two_links(a=shape(BOX), b=inertial() + shape(BOX))
    robot = load(given)
    assert robot.estimated == ""
    assert robot.text == given


def test_mass_of_the_arm_is_spread_over_what_is_estimated(load):
    text = two_links(a=shape(BOX), b=shape(BOX), c=inertial("2"))
    robot = load(text, mass_kg=10.0)  # of which the file gives 2
    assert [mass_of(link_of(robot, name)) for name in "abc"] == pytest.approx([4.0, 4.0, 2.0])
    np.testing.assert_allclose(
        inertia_of(link_of(robot, "b")), 0.5 * np.array(BOX_INERTIA), rtol=1e-5, atol=1e-12
    )
    assert robot.reading == {"mass_kg": 10.0}
    for wrong, message in ((text, "more than the 2 kg"), (two_links(), "must be left out")):
        with pytest.raises(RobotDescriptionError, match=rf"robot\.mass_kg = 1 \(.*{message}"):
            load(wrong, mass_kg=1.0)


def test_estimates_are_marked_in_warnings_scenario_conditions_and_copies(load, tmp_path):
    robot = load(two_links(b=shape(BOX), c=shape(BOX)))
    setup = at_rest(robot)  # a scenario that names no source
    mark = "inertia of 2 links ESTIMATED from their shapes: 16 kg"
    assert any(mark in each for each in scenario_warnings(setup))
    assert mark in conditions_of_runs([setup], {})["drives"]
    assert starter_scenario(robot)["robot"]["drive_data"].startswith(mark)
    (tmp_path / "run").mkdir()
    write_scenario(setup, tmp_path / "run" / "scenario.yaml")
    copy = load_setup(str(tmp_path / "run" / "scenario.yaml"))
    assert copy.robot.estimated == mark
    assert copy.governing_inertia_kg_m2.tolist() == setup.governing_inertia_kg_m2.tolist()


def test_replaced_inertia_states_by_how_much_it_changes_a_joint(load):
    """The second link hardly matters to the first joint, and a fixed one hardly to any."""
    light = inertial("0.001", "1e-9", "1e-9", "1e-6").replace("0.2 0 0", "0 0 0")
    fixed = joint("mount", "b", "d", "fixed")
    robot = load(two_links(more=f'<link name="d">{light}</link>{fixed}'))
    (text,) = robot.warnings
    assert "link d breaks the triangle rule by 1e+02 %" in text
    assert "the inertia of joint first by 7.8e-05 %" in text
    moved = ManipulatorModel(robot).mass_matrix(np.zeros(2))[0, 0]
    plain = ManipulatorModel(load(two_links())).mass_matrix(np.zeros(2))[0, 0]
    assert moved - plain == pytest.approx(0.5e-6 + 0.001 * 0.3**2, abs=1e-8)


def test_replaced_inertia_that_no_joint_feels_names_none(load):
    slides = two_links(c=inertial(izz="0.4")).replace('"revolute"', '"prismatic"')
    (text,) = (each for each in load(slides).warnings if "triangle rule" in each)
    assert text.endswith("raised as far as necessary")


def test_replacement_that_changes_a_joint_much_needs_repair(load):
    far = two_links(c=inertial(izz="0.4"))
    with pytest.raises(RobotDescriptionError, match=r"--repair .* joint second by 1.6e"):
        load(far)
    assert load(far, repair=True).reading == {"repair": True}


def test_arm_that_falls_under_its_estimated_weight_is_read_alike_by_all(load, tmp_path):
    robot = load(two_links(b=shape(BOX), c=shape(BOX)))
    again = load_robot(robot.path)
    assert again.text == robot.text
    gravity = ManipulatorModel(robot).gravity(np.zeros(2))
    assert gravity[1] == pytest.approx(-8.0 * 9.81 * 0.2, rel=1e-5)

"""MJCF files of arms with grippers, bases and several files move as MuJoCo reads them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bus_schema.errors import RobotDescriptionError
from bus_schema.robot_description import load_robot
from controller.manipulator_model import ManipulatorModel
from tests.bus_schema.urdf.test_from_mjcf import compare_dynamics
from tests.bus_schema.urdf.test_inertia_estimate import CORNERS

SHARED = Path(__file__).parents[4] / "shared/arms"

FINGERS = """
<body name="left" pos="0 0.02 0.1"><joint name="left" type="slide" axis="0 1 0" range="0 .04"/>
  <geom size="0.01 0.01 0.03" type="box" mass="0.05"/><site name="l"/></body>
<body name="right" pos="0 -0.02 0.1"><joint name="right" axis="0 1 0"/>
  <geom size="0.01 0.01 0.03" type="box" mass="0.05"/><site name="r"/>
  <body name="pad" pos="0 0 0.03"><joint name="pad" axis="1 0 0"/>
    <geom size="0.01" mass="0.01"/></body></body>
"""
ARM = """
<mujoco><compiler angle="radian" meshdir="meshes"/>{assets}
  <worldbody><geom type="plane" size="1 1 1"/>
    <body name="base">{base}<geom size="0.1" mass="3"/>
    <body name="upper" pos="0 0 0.3"><joint name="shoulder" axis="0 1 0" range="-2 2"/>
      <geom type="capsule" fromto="0 0 0 0 0.1 0.3" size="0.04" mass="2"/>
      <body name="fore" pos="0 0.1 0.3"><joint name="elbow" axis="0 1 0.2" range="-2 2"/>
        <geom type="capsule" fromto="0 0 0 0.1 0 0.3" size="0.03" mass="1"/>{inside}</body></body>
    </body></worldbody>
  <actuator><motor joint="shoulder" ctrlrange="-50 50"/><motor joint="elbow" ctrlrange="-20 20"/>
  {actuators}</actuator>{more}
</mujoco>
"""
SPLIT = (
    '<tendon><fixed name="split"><joint joint="left" coef=".5"/><joint joint="right" coef=".5"/>'
)
FIXED = SPLIT + "</fixed></tendon>"
SPATIAL = '<tendon><spatial name="split"><site site="l"/><site site="r"/></spatial></tendon>'
ON_TENDON = '<position tendon="split" kp="100" ctrlrange="0 1"/>'
OWN = '<motor joint="left"/><motor joint="right"/>'


def arm(inside="", actuators="", more="", assets="", base=""):
    return ARM.format(inside=inside, actuators=actuators, more=more, assets=assets, base=base)


def load(folder, text, *arguments, **options):
    file = folder / "arm.xml"
    file.write_text(text)
    return load_robot(file, *arguments, **options)


@pytest.mark.parametrize(
    ("actuators", "more"),
    [
        (ON_TENDON, FIXED),
        (ON_TENDON, SPATIAL),
        (OWN, '<equality><joint joint1="left" joint2="right"/></equality>'),
        (OWN, '<equality><connect body1="left" body2="pad" anchor="0 0 0"/></equality>'),
        (OWN, '<equality><weld site1="l" site2="r"/></equality>'),
    ],
    ids=["tendon", "spatial tendon", "joints", "closed chain", "weld"],
)
def test_coupled_fingers_are_held_with_their_mass(tmp_path, actuators, more):
    text = arm(FINGERS, actuators, more)
    robot = load(tmp_path, text)
    assert robot.joint_names == ("shoulder", "elbow")
    (message,) = (each for each in robot.warnings if "left" in each)
    assert message.startswith("MJCF: left, right")
    assert "held as one rigid body with its mass" in message
    compare_dynamics(robot, text)


def test_constraint_with_the_world_or_out_of_force_couples_no_joint(tmp_path):
    for more in (
        '<equality><weld body1="fore" body2="world"/></equality>',
        '<equality><joint joint1="elbow" joint2="shoulder" active="false"/></equality>',
    ):
        assert load(tmp_path, arm(more=more)).joint_names == ("shoulder", "elbow")


def test_joints_that_are_named_are_driven(tmp_path):
    text = arm(FINGERS, ON_TENDON, FIXED)
    assert load(tmp_path, text, ["elbow", "left"]).joint_names == ("elbow", "left")
    assert load(tmp_path, text, ["pad"]).effort_limits_nm.tolist() == [np.inf]
    with pytest.raises(RobotDescriptionError, match="not 'thumb'"):
        load(tmp_path, text, ["thumb"])


@pytest.mark.parametrize(
    ("base", "message"),
    [
        ("<freejoint/>", "body base is free, and fixed to the world"),
        ('<joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/>'
         '<joint name="yaw" axis="0 0 1"/>', "x, y, yaw: those of a mobile base; held"),
    ],
)  # fmt: skip
def test_floating_or_mobile_base_is_fixed(tmp_path, base, message):
    robot = load(tmp_path, arm(base=base))
    assert robot.joint_names == ("shoulder", "elbow")
    assert any(message in each for each in robot.warnings)
    compare_dynamics(robot, arm())


def test_included_and_attached_files_are_read(tmp_path):
    whole, hand = arm(FINGERS, OWN), tmp_path / "parts"
    hand.mkdir()
    (hand / "fingers.xml").write_text(f"<mujocoinclude>{FINGERS}</mujocoinclude>")
    compare_dynamics(load(tmp_path, arm('<include file="parts/fingers.xml"/>', OWN)), whole)
    model = f'<mujoco><worldbody><body name="palm">{FINGERS}</body></worldbody></mujoco>'
    (hand / "hand.xml").write_text(model)
    (tmp_path / "arms").mkdir()
    attached = arm(
        '<attach model="hand" body="palm" prefix="h/"/>', OWN.replace('joint="', 'joint="h/'),
        assets='<asset><model name="hand" file="../parts/hand.xml"/></asset>',
    )  # fmt: skip
    robot = load(tmp_path / "arms", attached)
    assert robot.joint_names == ("shoulder", "elbow", "h/right")  # h/left slides beside it
    assert robot.tip_link == "h/pad"
    chosen = load(tmp_path / "arms", attached, ["shoulder", "elbow"])
    compare_dynamics(chosen, whole)


def test_more_than_fifty_files_are_included(tmp_path):
    (tmp_path / "parts").mkdir()
    names = [f"parts/{number}.xml" for number in range(60)]
    for number, name in enumerate(names):
        geom = f'<geom size="0.01" mass="0.001" pos="{0.001 * number} 0 0"/>'
        (tmp_path / name).write_text(f"<mujocoinclude>{geom}</mujocoinclude>")
    inside = "".join(f'<include file="{name}"/>' for name in names)
    whole = "".join((tmp_path / name).read_text()[15:-16] for name in names)
    compare_dynamics(load(tmp_path, arm(inside)), arm(whole))


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("parts/../../../out.xml", "<mujoco/>", "must be below"),
        ("own/hand.txt", "<mujoco/>", "its name must end with .xml or .mjcf"),
        ("own/hand.xml", "no model", "hand.xml cannot be read as MJCF"),
        ("own/hand.xml", '<mujoco><include file="hand.xml"/></mujoco>', "hand.xml includes itself"),
        ("own/hand.xml", '<mujoco><asset><model name="h" file="hand.xml"/></asset></mujoco>',
         "hand.xml attaches itself"),
        ("own/hand.xml", '<mujoco><worldbody><composite/></worldbody></mujoco>', "<composite>"),
        ("own/hand.xml", '<mujoco><asset><texture file="/dev/zero"/></asset></mujoco>', ""),
    ],
)  # fmt: skip
def test_files_of_files_are_checked_before_mujoco_reads_them(tmp_path, file, content, message):
    folder = tmp_path / "a" / "b"
    (folder / "own").mkdir(parents=True)
    (folder / "parts").mkdir()
    (folder / file).write_text(content)
    text = arm(assets=f'<asset><model name="hand" file="{file}"/></asset>')
    if not message:
        assert load(folder, text).joints == 2
        return
    with pytest.raises(RobotDescriptionError) as caught:
        load(folder, text)
    assert message in str(caught.value)


def test_inertia_of_meshes_is_that_of_mujoco(tmp_path):
    (tmp_path / "meshes").mkdir()
    places = "".join(f"v {x} {y} {z}\n" for x, y, z in CORNERS)
    faces = "".join(f"f {i} {i + 1} {i + 2}\n" for i in range(1, 7))
    (tmp_path / "meshes" / "box.obj").write_text(places + faces)
    assets = '<asset><mesh file="box.obj" inertia="convex" scale="0.5 1 1"/></asset>'
    box = '<body name="tool" pos="0 0 0.3"><geom type="mesh" mesh="box" density="500"/></body>'
    robot = load(tmp_path, arm(box, assets=assets))
    absolute = assets.replace("box.obj", str(tmp_path / "meshes" / "box.obj"))
    compare_dynamics(robot, arm(box, assets=absolute.replace("<mesh", '<mesh name="box"')))
    (tmp_path / "meshes" / "box.obj").write_text("v 0 0 0")
    with pytest.raises(RobotDescriptionError, match="MuJoCo: "):
        load(tmp_path, arm(box, assets=assets))


@pytest.mark.skipif(not SHARED.is_dir(), reason="arms of others are not beside the repository")
@pytest.mark.parametrize(
    "file",
    [
        "21-openarm-mjcf/v1/openarm.xml",
        "21-openarm-mjcf/v2/pedestal/openarm_pedestal.xml",
        "22-mink-mjcf/examples/ufactory_xarm7/xarm7.xml",
        "22-mink-mjcf/examples/aloha/scene.xml",
        "22-mink-mjcf/examples/stanford_tidybot/scene_mobile_kinova.xml",
        "22-mink-mjcf/examples/boston_dynamics_spot/spot_arm.xml",
    ],
)
def test_grippers_of_others_are_held(file):
    robot = load_robot(SHARED / file)
    assert ManipulatorModel(robot).joints >= 6
    assert robot.estimated == ""
    assert not [name for name in robot.joint_names if "finger" in name or "driver" in name]


@pytest.mark.parametrize(("ctrlrange", "is_named"), [("-0.9 0.9", True), ("-1.5 1.5", False)])
def test_ctrlrange_that_cuts_a_range_is_named_with_both(tmp_path, ctrlrange, is_named):
    servo = f'<position joint="shoulder" kp="50" ctrlrange="{ctrlrange}"/>'
    text = arm().replace('<motor joint="shoulder" ctrlrange="-50 50"/>', servo)
    robot = load(tmp_path, text)
    expected = "range: shoulder (-0.9 … 0.9 of -2 … 2)"
    assert any(expected in each for each in robot.warnings) is is_named

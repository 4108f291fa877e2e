"""MJCF as URDF: the same masses, inertias and frames as pinocchio reads from the MJCF itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio
import pytest

from bus_schema.errors import RobotDescriptionError
from bus_schema.robot_description import RobotDescription, load_robot
from controller.manipulator_model import ManipulatorModel
from tests.arms import PYBULLET_DATA, needs_pybullet_data

ARM = """
<mujoco model="arm">
  <compiler angle="radian" eulerseq="zyx"/>
  <default>
    <joint damping="1" axis="0 1 0"/>
    <default class="light"><geom density="300" type="capsule" size="0.03"/></default>
    <default class="strong"><motor gear="50" ctrlrange="-2 1"/></default>
  </default>
  <worldbody>
    <geom type="plane" size="1 1 .1"/>
    <body name="turret" pos="0.1 0 0.4" euler="0.3 -0.2 0.5">
      <joint name="yaw" axis="0 0 2" pos="0.01 0.02 0" range="-2 2"/>
      <inertial pos="0.01 0 0.1" quat="0.9 0.1 0.2 0.3" mass="4" diaginertia="0.03 0.02 0.025"/>
      <geom type="box" size="9 9 9"/>
      <body name="upper" pos="0 0.05 0.3" axisangle="0 0.6 0.8 0.4" childclass="light">
        <joint name="pitch" pos="0 -0.03 0.02" ref="0.2"/>
        <geom fromto="0 0 0 0.1 0.05 0.3"/>
        <geom type="box" size="0.05 0.06 0.02" pos="0 0 0.3" euler="0.1 0.2 0.3"/>
        <body name="bracket" pos="0 0 0.35" xyaxes="0 1 0 -0.6 0 0.8">
          <geom type="cylinder" size="0.02 0.05" mass="0.4" zaxis="0.6 0 0.8"/>
          <body name="slider" zaxis="0 -0.6 0.8">
            <joint name="reach" type="slide" axis="1 1 0" range="0 0.3"/>
            <geom type="ellipsoid" size="0.03 0.04 0.05"/>
            <geom type="sphere" pos="0.1 0 0" density="900"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor class="strong" joint="yaw"/>
    <motor joint="pitch" gear="-3" forcerange="-5 5"/>
    <position joint="reach" kp="10" ctrlrange="-1 1"/>
  </actuator>
</mujoco>
"""


def load(folder: Path, text: str) -> RobotDescription:
    file = folder / "arm.xml"
    file.write_text(text)
    return load_robot(file)


def mass_matrices(path: Path, robot: RobotDescription, joints: tuple[str, ...]) -> None:
    """Compare with pinocchio's own reading at random positions of some joints."""
    theirs = pinocchio.buildModelFromMJCF(str(path))
    theirs.armature[:] = 0.0  # which is left out, and told
    data, ours = theirs.createData(), ManipulatorModel(robot)
    places = [theirs.joints[theirs.getJointId(name)].idx_v for name in joints]
    generator = np.random.default_rng(3)
    for _ in range(10):
        position = generator.uniform(-1.0, 1.0, len(joints))
        q = pinocchio.neutral(theirs)
        q[places] = position
        wanted = pinocchio.crba(theirs, data, q)
        wanted = np.triu(wanted) + np.triu(wanted, 1).T
        wanted = wanted[np.ix_(places, places)]
        found = ours.mass_matrix(position)
        np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-9 * abs(wanted).max())
        gravity = pinocchio.computeGeneralizedGravity(theirs, data, q)[places]
        np.testing.assert_allclose(
            ours.gravity(position), gravity, rtol=1e-9, atol=1e-9 * abs(gravity).max()
        )


def test_arm_with_all_that_turns_and_weighs_is_pinocchios(tmp_path: Path) -> None:
    text = ARM.replace(' ref="0.2"', "")  # which pinocchio has as the neutral position alone
    robot = load(tmp_path, text)
    assert robot.joint_names == ("yaw", "pitch", "reach")
    assert robot.slides == (False, False, True)
    mass_matrices(tmp_path / "arm.xml", robot, robot.joint_names)
    np.testing.assert_allclose(robot.effort_limits_nm, [100.0, 15.0, np.inf])
    np.testing.assert_allclose(robot.lower_rad, [-2.0, -np.inf, 0.0])
    np.testing.assert_allclose(robot.upper_rad, [2.0, np.inf, 0.3])
    assert robot.tip_link == "slider"


@pytest.mark.parametrize(
    ("written", "otherwise"),
    [
        ('axisangle="0 0.6 0.8 0.4"', 'axisangle="0 3 4 0.4"'),
        ('zaxis="0 -0.6 0.8"', 'zaxis="0 -3 4"'),
        ('quat="0.9 0.1 0.2 0.3"', 'quat="-1.8 -0.2 -0.4 -0.6"'),
        ('xyaxes="0 1 0 -0.6 0 0.8"', 'xyaxes="0 2 0 -3 7 4"'),  # y is made orthogonal to x
        # Large letters turn about axes that stay, so that the last turn comes first.
        ('eulerseq="zyx"', 'eulerseq="ZYX"'),
    ],
)
def test_directions_need_no_length(tmp_path: Path, written: str, otherwise: str) -> None:
    """As MuJoCo has it; pinocchio takes them as they are."""
    text = ARM.replace(otherwise, written)
    other = ARM.replace(written, otherwise)
    if "euler" in written:
        other = other.replace('euler="0.3 -0.2 0.5"', 'euler="0.5 -0.2 0.3"').replace("ZYX", "XYZ")
        other = other.replace('euler="0.1 0.2 0.3"', 'euler="0.3 0.2 0.1"')
    assert other != text
    position = np.array([0.4, -0.3, 0.1])
    matrices = [
        ManipulatorModel(load(tmp_path, each)).mass_matrix(position) for each in (text, other)
    ]
    np.testing.assert_allclose(*matrices, rtol=1e-12)


def test_joint_at_its_reference_is_where_the_file_draws_it(tmp_path: Path) -> None:
    drawn = ManipulatorModel(load(tmp_path, ARM.replace(' ref="0.2"', "")))
    referred = ManipulatorModel(load(tmp_path, ARM))
    np.testing.assert_allclose(
        referred.tip_position(np.array([0.3, 0.7, 0.1])),
        drawn.tip_position(np.array([0.3, 0.5, 0.1])),
        atol=1e-12,
    )


@needs_pybullet_data
@pytest.mark.parametrize("name", ["pusher", "inverted_pendulum", "inverted_double_pendulum"])
def test_arms_of_pybullet_data_are_pinocchios(name: str, tmp_path: Path) -> None:
    """With their actuators left out, so that all joints move."""
    path = PYBULLET_DATA / "mjcf" / f"{name}.xml"
    text = path.read_text()
    start, end = text.index("<actuator>"), text.index("</actuator>") + len("</actuator>")
    text = text[:start] + text[end:]
    # Geoms that touch nothing have mass for MuJoCo, and none for pinocchio.
    text = text.replace('contype="0"', "").replace('conaffinity="0"', "")
    (tmp_path / "arm.xml").write_text(text)
    # Of objects beside the arm, two joints move one body.
    wanted = load_robot(path).joint_names if name == "pusher" else None
    robot = load_robot(tmp_path / "arm.xml", wanted)
    mass_matrices(tmp_path / "arm.xml", robot, robot.joint_names)


@needs_pybullet_data
def test_what_is_left_out_is_told(tmp_path: Path) -> None:
    reacher = load_robot(PYBULLET_DATA / "mjcf/reacher.xml")
    assert reacher.joint_names == ("joint0", "joint1")
    assert reacher.effort_limits_nm.tolist() == [200.0, 200.0]
    passive, left_out, *_ = reacher.warnings
    assert "target_x, target_y: no actuator" in passive
    assert "armature, damping" in left_out
    striker = load_robot(PYBULLET_DATA / "mjcf/striker.xml")
    assert any("body target is free" in each for each in striker.warnings)
    assert any("gravity 0 0 0" in each for each in striker.warnings)


def test_compensated_gravity_is_told_by_body(tmp_path: Path) -> None:
    text = ARM.replace('<body name="slider"', '<body name="slider" gravcomp="1"')
    assert text != ARM
    said = [each for each in load(tmp_path, text).warnings if "gravcomp" in each]
    assert said == ["MJCF: gravcomp of body slider is left out: gravity pulls on all of it here"]
    assert not any("gravcomp" in each for each in load(tmp_path, ARM).warnings)
    with pytest.raises(RobotDescriptionError, match="gravcomp='high' of body slider"):
        load(tmp_path, text.replace('gravcomp="1"', 'gravcomp="high"'))


@pytest.mark.parametrize(
    ("defaults", "actuator", "effort"),
    [
        ('<general forcerange="-5 5"/>', '<motor joint="j" ctrlrange="-100 100"/>', 5.0),
        ('<position forcerange="-5 5"/>', '<velocity joint="j"/>', 5.0),
        ('<general gear="3"/><motor gear="4"/>', '<motor joint="j" ctrlrange="-2 2"/>', 8.0),
        ('<motor gear="4"/><general gear="3"/>', '<motor joint="j" ctrlrange="-2 2"/>', 6.0),
        ('<motor gear="4"/><default class="c"><general forcerange="-5 5"/></default>',
         '<position class="c" joint="j"/>', 20.0),
        ('<general ctrlrange="-2 2"/>', '<position joint="j"/>', np.inf),
    ],
)  # fmt: skip
def test_actuators_of_all_kinds_share_their_defaults(
    tmp_path: Path, defaults: str, actuator: str, effort: float
) -> None:
    """As for MuJoCo, where the last word of a class holds for every kind."""
    robot = load(
        tmp_path,
        f"<mujoco><default>{defaults}</default><worldbody>{BODY.format(HINGE)}</worldbody>"
        f"<actuator>{actuator}</actuator></mujoco>",
    )
    assert robot.effort_limits_nm.tolist() == [effort]


MESH = '<geom class="seen" mesh="m"/>'
SHELL = '<geom name="g" class="hollow" size="0.2"/>'
OWN = '<inertial pos="0.1 0 0" mass="2" diaginertia="0.1 0.2 0.3"/>'
BALL = '<geom name="ball" size="0.1" mass="3"/>'


def with_geoms(inside: str, seen: str = "", compiler: str = "") -> str:
    """One body that turns, with geoms or an inertia of its own."""
    return f"""<mujoco><compiler {compiler}/>
      <default>
        <default class="seen"><geom type="mesh" {seen}/></default>
        <default class="hollow"><geom shellinertia="true"/></default>
      </default>
      <worldbody><body name="b"><joint name="j"/>{inside}</body></worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (with_geoms(MESH + BALL), "body b has the inertia of a mesh"),
        (with_geoms(MESH + BALL, seen='density="0" mass="1"'), "body b has the inertia of a mesh"),
        (with_geoms('<geom type="sdf" mesh="m"/>' + BALL), "body b has the inertia of a mesh"),
        (with_geoms(MESH + OWN, compiler='inertiafromgeom="true"'),
         "body b has the inertia of a mesh"),
        (with_geoms(SHELL + BALL),
         "shellinertia='true' of geom g of body b: must be false, or the body must have"),
        (with_geoms(SHELL + OWN, compiler='inertiafromgeom="true"'), "shellinertia='true'"),
    ],
)  # fmt: skip
def test_inertias_of_meshes_and_shells_are_refused(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(RobotDescriptionError) as raised:
        load(tmp_path, text)
    assert said in str(raised.value)
    assert str(tmp_path / "arm.xml") in str(raised.value)


@pytest.mark.parametrize(
    ("text", "inertia"),
    [
        (with_geoms(MESH + BALL, seen='mass="0"'), 0.4 * 3 * 0.1**2),
        (with_geoms(MESH + BALL, seen='density="0.0"'), 0.4 * 3 * 0.1**2),
        (with_geoms(MESH + BALL, seen='density="9" mass="0"'), 0.4 * 3 * 0.1**2),
        (with_geoms('<geom class="seen" type="sphere" size="0.1" mass="3"/>'), 0.4 * 3 * 0.1**2),
        (with_geoms(SHELL.replace("/>", ' mass="0"/>') + BALL), 0.4 * 3 * 0.1**2),
        (with_geoms(MESH + SHELL + OWN), 0.3 + 2 * 0.1**2),
        (with_geoms(MESH + SHELL + OWN, compiler='inertiafromgeom="false"'), 0.3 + 2 * 0.1**2),
        (with_geoms(MESH + OWN, seen='mass="0"', compiler='inertiafromgeom="true"'),
         0.3 + 2 * 0.1**2),
    ],
)  # fmt: skip
def test_meshes_and_shells_that_weigh_nothing_are_taken(
    tmp_path: Path, text: str, inertia: float
) -> None:
    model = ManipulatorModel(load(tmp_path, text))
    np.testing.assert_allclose(model.mass_matrix(np.zeros(1)), [[inertia]], rtol=1e-12)


BODY = '<body name="b">{}<geom size="0.1"/></body>'
HINGE = '<joint name="j" type="hinge"/>'


@pytest.mark.parametrize(
    ("inside", "said"),
    [
        ("<worldbody>" + BODY.format('<joint name="j" type="ball"/>') + "</worldbody>",
         "type='ball' of joint j of body b: must be hinge or slide"),
        ("<worldbody>" + BODY.format("<freejoint/>") + "</worldbody>", "body b has a free joint"),
        ('<compiler coordinate="global"/><worldbody/>',
         "coordinate='global' of compiler: must be local"),
        ("<worldbody/><equality><weld name='w'/></equality>", "equality w: must be left out"),
        ("<worldbody/><tendon><fixed name='t'/></tendon>", "tendon t: must be left out"),
        ('<include file="x"/><worldbody/>', "<include> is not understood"),
        ("", "has no worldbody"),
        ("<worldbody>" + BODY.format('<joint name="j" axis="0 0 0"/>') + "</worldbody>",
         "axis of joint j is zero"),
        ("<worldbody>" + BODY.format('<joint name="j" class="x"/>') + "</worldbody>",
         "class='x' of joint j: must be one of main"),
        ("<worldbody>" + BODY.format('<joint name="j" pos="0 nan 0"/>') + "</worldbody>",
         "pos='nan' of joint j is no finite number"),
        ("<worldbody>" + BODY.format('<joint name="j" range="1"/>') + "</worldbody>",
         "range='1' of joint j: must be 2 numbers"),
        (f'<worldbody><body name="b">{HINGE}<geom type="box" size="1 2"/></body></worldbody>',
         "must be 3 positive numbers for a box"),
        (f'<worldbody><body name="b">{HINGE}<geom type="mesh" mesh="m"/></body></worldbody>',
         "body b has the inertia of a mesh: give it an <inertial>"),
        ("<default class='a'>" * 500 + "</default>" * 500 + "<worldbody/>",
         "more than 100 defaults lie within one another"),
        ("<worldbody>" + "<body>" * 500 + "</body>" * 500 + "</worldbody>",
         "more than 100 bodies carry one another"),
        ("<worldbody>" + BODY.format(HINGE) + "</worldbody><actuator><motor joint='k'/></actuator>",
         "joint='k' of an actuator: there is no such joint"),
        ("<worldbody>" + BODY.format(HINGE + '<joint name="k" type="slide"/>') + "</worldbody>",
         "which joint j moves, has no inertia"),
    ],
)  # fmt: skip
def test_what_cannot_be_taken_is_refused_with_file_and_element(
    tmp_path: Path, inside: str, said: str
) -> None:
    with pytest.raises(RobotDescriptionError) as raised:
        load(tmp_path, f"<mujoco>{inside}</mujoco>")
    assert said in str(raised.value)
    assert str(tmp_path / "arm.xml") in str(raised.value)

"""MJCF as URDF: the dynamics are those that MuJoCo computes from the MJCF itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bus_schema.errors import RobotDescriptionError
from bus_schema.mujoco_library import mujoco
from bus_schema.robot_description import RobotDescription, load_robot
from controller.manipulator_model import ManipulatorModel
from tests.arms import PYBULLET_DATA, needs_pybullet_data

TAKEN = ("ant", "pusher", "striker", "inverted_double_pendulum")

ARM = """
<mujoco model="arm">
  <compiler angle="radian" eulerseq="zyx"/>
  <default>
    <joint damping="1" axis="0 1 0"/>
    <default class="light"><geom density="300" type="capsule" size="0.03"/></default>
    <default class="strong"><motor gear="50" ctrlrange="-2 1"/></default>
  </default>
  <asset><mesh name="m" file="missing.stl"/><material name="red"/></asset>
  <worldbody>
    <geom type="plane" size="1 1 .1"/>
    <body name="turret" pos="0.1 0 0.4" euler="0.3 -0.2 0.5">
      <joint name="yaw" axis="0 0 2" pos="0.01 0.02 0" range="-2 2"/>
      <inertial pos="0.01 0 0.1" quat="0.9 0.1 0.2 0.3" mass="4" diaginertia="0.03 0.02 0.025"/>
      <geom type="box" size="9 9 9"/><geom type="mesh" mesh="m" material="red"/>
      <body name="upper" pos="0 0.05 0.3" axisangle="0 0.6 0.8 0.4" childclass="light">
        <joint name="pitch" pos="0 -0.03 0.02" ref="0.2"/>
        <geom fromto="0 0 0 0.1 0.05 0.3"/>
        <geom type="box" size="0.05 0.06 0.02" pos="0 0 0.3" euler="0.1 0.2 0.3"/>
        <frame pos="0 0 0.35">
          <body name="bracket" xyaxes="0 1 0 -0.6 0 0.8">
            <geom type="cylinder" size="0.02 0.05" mass="0.4" zaxis="0.6 0 0.8"/>
            <body name="slider" pos="0 0.1 0" euler="0 1.5707963267948966 0.3">
              <joint name="reach" type="slide" axis="1 1 0" range="0 0.3" ref="0.1"/>
              <geom type="ellipsoid" size="0.03 0.04 0.05"/>
              <geom type="sphere" pos="0.1 0 0" density="900"/>
            </body>
          </body>
        </frame>
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


def refusal(folder: Path, text: str) -> str:
    with pytest.raises(RobotDescriptionError) as raised:
        load(folder, text)
    assert str(raised.value).startswith(str(folder / "arm.xml"))
    assert len(str(raised.value).splitlines()) == 1
    return str(raised.value)


def compare_dynamics(robot: RobotDescription, text: str) -> None:
    """Compare mass matrix and gravity with MuJoCo's at random positions of the driven joints."""
    theirs = mujoco.MjModel.from_xml_string(text)
    theirs.dof_armature[:] = 0.0  # which is for the motors, not for the links
    theirs.opt.gravity[:] = 0.0, 0.0, -9.81
    data, ours = mujoco.MjData(theirs), ManipulatorModel(robot)
    joints = [theirs.joint(name) for name in robot.joint_names]
    places = [joint.dofadr[0] for joint in joints]
    generator = np.random.default_rng(3)
    for position in generator.uniform(-1.0, 1.0, (10, robot.joints)):
        data.qpos[:] = [0.0] * theirs.nq
        data.qpos[[joint.qposadr[0] for joint in joints]] = position
        mujoco.mj_forward(theirs, data)
        wanted = np.zeros((theirs.nv, theirs.nv))
        for row, unit in zip(wanted, np.eye(theirs.nv), strict=True):
            mujoco.mj_mulM(theirs, data, row, unit)
        wanted, gravity = wanted[np.ix_(places, places)], data.qfrc_bias[places]
        scale = 1e-9 * abs(wanted).max()
        np.testing.assert_allclose(ours.mass_matrix(position), wanted, rtol=1e-9, atol=scale)
        np.testing.assert_allclose(ours.gravity(position), gravity, rtol=1e-9, atol=10 * scale)


def test_arm_with_all_that_turns_and_weighs_moves_as_in_mujoco(tmp_path: Path) -> None:
    robot = load(tmp_path, ARM)
    assert robot.joint_names == ("yaw", "pitch", "reach")
    assert robot.slides == (False, False, True)
    assert robot.effort_limits_nm.tolist() == [100.0, 15.0, np.inf]
    assert robot.lower_rad.tolist() == [-2.0, -np.inf, 0.0]
    assert robot.upper_rad.tolist() == [2.0, np.inf, 0.3]
    assert robot.tip_link == "slider"
    compare_dynamics(robot, ARM.replace('<geom type="mesh" mesh="m" material="red"/>', "")
                     .replace('<mesh name="m" file="missing.stl"/>', ""))  # fmt: skip


@needs_pybullet_data
@pytest.mark.parametrize("name", TAKEN)
def test_arms_of_pybullet_data_move_as_in_mujoco(name: str) -> None:
    path = PYBULLET_DATA / "mjcf" / f"{name}.xml"
    compare_dynamics(load_robot(path), path.read_text().replace('collision="predefined"', ""))


@needs_pybullet_data
def test_what_is_left_out_is_reported(tmp_path: Path) -> None:
    reacher = load_robot(PYBULLET_DATA / "mjcf/reacher.xml")
    assert reacher.joint_names == ("joint0", "joint1")
    assert reacher.effort_limits_nm.tolist() == [200.0, 200.0]
    assert "target_x, target_y: no actuator" in reacher.warnings[0]
    striker = load_robot(PYBULLET_DATA / "mjcf/striker.xml")
    assert any("body target is free" in each for each in striker.warnings)
    assert any("gravity 0 0 0" in each for each in striker.warnings)
    floating = ARM.replace('<body name="slider"', '<body name="slider" gravcomp="1"')
    floated = load(tmp_path, floating.replace('damping="1"', 'stiffness="1"'))
    ctrlrange, stiffness, gravcomp = floated.warnings
    assert "ctrlrange of actuator 0: not symmetric" in ctrlrange
    assert "stiffness of joint yaw, joint pitch, joint reach: it is left out" in stiffness
    assert "gravcomp of body slider" in gravcomp


def test_motors_and_friction_are_taken_over(tmp_path: Path) -> None:
    own = ARM.replace('name="pitch"', 'name="pitch" armature="0.2" frictionloss="3" damping="4"')
    drives = load(tmp_path, own).drives
    assert drives.rotor_inertia_kg_m2.tolist() == [0.0, 0.2, 0.0]
    assert drives.friction_nm.tolist() == [0.0, 3.0, 0.0]
    assert drives.damping_nm_s.tolist() == [1.0, 4.0, 1.0]


@pytest.mark.parametrize(
    ("actuators", "limits"),
    [  # lower, upper, velocity, K, D: at the joint, whose position is the length over the gear
        ('<position joint="j" gear="-2" kp="30" kv="4" ctrlrange="-1 3"/>',
         (-1.5, 0.5, np.inf, 120.0, 16.0)),
        ('<position joint="j" kp="30" ctrlrange="-9 9"/>', (-2.0, 2.0, np.inf, 30.0, 0.0)),
        ('<velocity joint="j" gear="2" kv="3" ctrlrange="-5 4"/>', (-2.0, 2.0, 2.5, 0.0, 12.0)),
        ('<general joint="j" biastype="affine" gainprm="5" biasprm="1 -10 -2" ctrlrange="-1 1"/>',
         (-0.4, 0.6, np.inf, 10.0, 2.0)),
        ('<position joint="j" kp="30" ctrlrange="-1 1"/><velocity joint="j" ctrlrange="-3 3"/>',
         (-1.0, 1.0, 3.0, 30.0, 1.0)),
        ('<intvelocity joint="j" kp="30" ctrlrange="-1 1" actrange="-1 1"/>',
         (-1.0, 1.0, 1.0, 30.0, 0.0)),
    ],
    ids=["position", "position, wider", "velocity", "general", "both", "integrated"],
)  # fmt: skip
def test_servos_limit_range_and_speed_and_have_gains(tmp_path, actuators, limits):
    joint = '<compiler angle="radian"/>' + BODY.format('<joint name="j" range="-2 2"/>')
    robot = load(tmp_path, f"<mujoco>{joint}<actuator>{actuators}</actuator></mujoco>")
    drives = robot.drives
    found = (
        robot.lower_rad, robot.upper_rad, robot.velocity_limits_rad_s,
        drives.servo_stiffness_nm_rad, drives.servo_damping_nm_s,
    )  # fmt: skip
    assert np.concatenate(found).tolist() == pytest.approx(limits)


def test_range_of_a_servo_is_that_of_a_joint_without_one(tmp_path: Path) -> None:
    servo = '<actuator><position joint="j" kp="30" ctrlrange="-1 1"/></actuator>'
    robot = load(tmp_path, f"<mujoco>{BODY.format(HINGE)}{servo}</mujoco>")
    assert (robot.lower_rad.tolist(), robot.upper_rad.tolist()) == ([-1.0], [1.0])


BODY = '<worldbody><body name="b">{}<geom name="ball" size="0.1" mass="3"/></body></worldbody>'
HINGE = '<joint name="j"/>'
MESH = '<geom type="mesh" mesh="m" {}/>'
OWN = '<inertial pos="0.1 0 0" mass="2" diaginertia="0.1 0.2 0.3"/>'
ASSET = '<asset><mesh name="m" file="m.stl"/></asset>'
FROM_GEOMS = '<compiler inertiafromgeom="true"/>'


@pytest.mark.parametrize(
    ("defaults", "actuator", "effort"),
    [
        ('<general forcerange="-5 5"/>', '<motor joint="j" ctrlrange="-100 100"/>', 5.0),
        ('<motor gear="4"/><general gear="3"/>', '<motor joint="j" ctrlrange="-2 2"/>', 6.0),
        ("", '<general joint="j" gainprm="-7" ctrlrange="-2 1"/>', 14.0),
        ('<general ctrlrange="-2 2"/>', '<position joint="j"/>', np.inf),
        ("", '<position joint="j" forcerange="-5 5"/><damper joint="j" forcerange="0 2"'
         ' ctrlrange="0 1" kv="1"/>', 7.0),
        ('<joint actuatorfrcrange="-3 2"/>', '<motor joint="j" ctrlrange="-5 5"/>', 3.0),
    ],
)  # fmt: skip
def test_effort_is_what_all_actuators_of_a_joint_can_do(tmp_path, defaults, actuator, effort):
    text = f"<default>{defaults}</default>{BODY.format(HINGE)}<actuator>{actuator}</actuator>"
    assert load(tmp_path, f"<mujoco>{text}</mujoco>").effort_limits_nm.tolist() == [effort]


@pytest.mark.parametrize(
    ("text", "inertia"),
    [
        (BODY.format(HINGE + MESH.format('mass="0"')), 0.4 * 3 * 0.1**2),
        (BODY.format(HINGE + MESH.format('density="0"')), 0.4 * 3 * 0.1**2),
        (BODY.format(HINGE + '<geom size="0.3" mass="2" shellinertia="true"/>'),
         0.4 * 3 * 0.1**2 + 2 / 3 * 2 * 0.3**2),
        (BODY.format(HINGE + MESH + OWN), 0.3 + 2 * 0.1**2),
        # The inertia of a body that stands does not matter.
        (f'<worldbody><body name="base">{MESH}'
         f'<body name="b">{HINGE}{OWN}</body></body></worldbody>', 0.3 + 2 * 0.1**2),
    ],
)  # fmt: skip
def test_meshes_that_do_not_weigh_are_dropped(tmp_path: Path, text: str, inertia: float) -> None:
    model = ManipulatorModel(load(tmp_path, f"<mujoco>{text.replace('{}', '')}</mujoco>"))
    np.testing.assert_allclose(model.mass_matrix(np.zeros(1)), [[inertia]], rtol=1e-12)


@pytest.mark.parametrize(
    ("inside", "message"),
    [
        (BODY.format('<joint name="j" type="ball"/>'), "joint j must be hinge or slide"),
        (BODY.format("<freejoint/>"), "body b has a free joint"),
        ("<extension><plugin plugin='p'/></extension>", "<plugin plugin='p'>: must be left out"),
        ('<worldbody><replicate count="9"/></worldbody>', "<replicate count='9'> is not supported"),
        ('<include file="x"/><worldbody/>', "<include file='x'>: no such file; its name must end"),
        ('<include file="/etc/passwd"/>', "<include file='/etc/passwd'>: no such file"),
        ('<include file="../../../out.xml"/>', "<include file='../../../out.xml'>: no such file"),
        ('<include file="arm.xml"/>', "<include file='arm.xml'>: arm.xml includes itself"),
        ("", "has no revolute, continuous or prismatic joint"),
        (BODY.format('<joint pos="0 nan 0"/>'), "<joint pos='0 nan 0'> is not a finite number"),
        (BODY.format(HINGE + '<geom mass="-NaN(7)"/>'), "mass of <geom mass='-NaN(7)'> is no"),
        (BODY.format('<joint name="j" range="1"/>'),
         "MuJoCo: attribute 'range' does not have enough data: <joint name='j' range='1'>"),
        ('<worldbody><body name="b"><joint/><geom size="1e200"/></body></worldbody>',
         "mass='inf' of link b is not a finite number"),
        (ASSET + BODY.format(HINGE + MESH), "<mesh file='m.stl'>: no such file"),
        (ASSET + FROM_GEOMS + BODY.format(HINGE + OWN + MESH), "<mesh file='m.stl'>: no such file"),
        ("<worldbody>" + "<body>" * 90000 + "</body>" * 90000 + "</worldbody>",
         "must not be nested deeper than 200 elements"),
        ("<worldbody>" + "<body/>" * 90000 + "</worldbody>", "90002 elements: at most 5000"),
        (BODY.format(f"{HINGE}<site name='s'/>")
         + "<actuator><general name='a' site='s'/></actuator>",
         "actuator 'a' must drive a joint"),
    ],
)  # fmt: skip
def test_what_cannot_be_taken_is_refused_with_file_and_element(tmp_path, inside, message):
    assert message in refusal(tmp_path, f"<mujoco>{inside.replace('{}', '')}</mujoco>")


def test_warnings_of_mujoco_leave_no_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    mujoco.MjSpec.from_string('<mujoco><worldbody><body pos="nan 0 0"/></worldbody></mujoco>')
    assert list(tmp_path.iterdir()) == []

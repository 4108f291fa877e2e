"""Actuators of MJCF files in a first scenario: the joint moves as MuJoCo moves it from the file."""

from typing import NamedTuple

import numpy as np
import pytest

from bus_schema.mujoco_library import mujoco
from bus_schema.robot_description import load_robot
from controller.manipulator_model import ManipulatorModel
from deploy.cli.robot import at_rest, robot_warnings
from deploy.scenario.scenario import build_setup
from deploy.scenario.starter import drives_of, starter_scenario

STEP_S = 0.00025
"""Of MuJoCo, and of our physics: a tick of 1 ms has four."""
LENGTH_S = 0.2
ARM = """<mujoco><option timestep="0.00025" integrator="implicitfast"/>
<compiler angle="radian"/>{before}<worldbody><body name="arm"><joint name="j" axis="0 0 1"
range="-6 6" {joint}/><geom type="capsule" fromto="0 0 0 .4 0 0" size=".03" mass="2"/></body>
</worldbody><actuator>{actuator}</actuator>{after}</mujoco>"""
ENDLESS_NM = 1e3


def text_of(actuator, *, joint="", before="", after=""):
    return ARM.format(actuator=actuator, joint=joint, before=before, after=after)


class Response(NamedTuple):
    """Positions and torques of the actuators after each step, shape (steps,), and M at rest."""

    position: np.ndarray
    torque: np.ndarray
    inertia: float


def in_mujoco(text, control):
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    inertia = np.zeros((1, 1))
    mujoco.mj_fullM(model, data, inertia)
    data.ctrl[: np.size(control)] = control
    rows = []
    for _ in range(round(LENGTH_S / STEP_S)):
        mujoco.mj_step(model, data)
        rows.append((data.qpos[0], data.qfrc_actuator[0]))
    return Response(*np.array(rows).T, float(inertia[0, 0]))


def read(tmp_path, text):
    (tmp_path / "arm.xml").write_text(text)
    return load_robot(tmp_path / "arm.xml")


def here(tmp_path, text, torque=0.0, target=None):
    """The response of our plant from the first scenario, without what it estimates."""
    robot = read(tmp_path, text)
    values = starter_scenario(robot)
    friction = values["plant"]["friction"]
    for key in [each for each in friction if each.endswith(("share", "share_s"))]:
        del friction[key]
    rotors = robot.drives.rotor_inertia_kg_m2
    actuator = values["plant"]["actuator"]
    actuator["rotor_inertia_kg_m2"] = rotors.tolist()
    limits = np.where(np.isinf(robot.effort_limits_nm), ENDLESS_NM, robot.effort_limits_nm)
    actuator["saturation_nm"] = values["limits"]["torque_nm"] = limits.tolist()
    values["robot"]["initial_offset_rad"] = [0.0]
    values["plant"].setdefault("drive_feedback", {})["enabled"] = target is not None
    values["plant"]["encoder"] = {}
    setup = build_setup(values, robot.path)
    plant = setup.arm()
    plant._bodies.place(np.zeros(1))
    plant.begin()
    aim = None if target is None else np.array(target, dtype=float)[:, None]
    plant.command(np.array([torque]), aim)
    rows = []
    for number in range(round(LENGTH_S / STEP_S)):
        plant.advance(number, number + 1)
        rows.append((plant.position[0], plant.torques.actuator[0]))
    inertia = ManipulatorModel(robot).mass_matrix(np.zeros(1))[0, 0] + rotors[0]
    return Response(*np.array(rows).T, inertia)


def compare(ours, theirs, *, torque=True):
    assert ours.inertia == pytest.approx(theirs.inertia, rel=1e-9)
    scale = abs(theirs.position).max()
    assert scale > 1e-3
    np.testing.assert_allclose(ours.position, theirs.position, atol=3e-3 * scale)
    if torque:
        scale = abs(theirs.torque).max()
        np.testing.assert_allclose(ours.torque, theirs.torque, atol=1e-2 * scale)


DELAYED = 'delay="0.02" nsample="80"'
GEARED = 'gear="-3" armature="0.01" damping="0.05"'


@pytest.mark.parametrize(
    ("attributes", "gain"),
    [
        ("", 1.0),
        ('gear="5"', 5.0),
        (DELAYED, 1.0),
        ('delay="0.01" nsample="80" interp="linear"', 1.0),
        ('armature="0.15"', 1.0),
        ('damping="1.5"', 1.0),
        (GEARED, -3.0),
        ('forcerange="-2 2"', 1.0),
        (f'{GEARED} {DELAYED} ctrlrange="-2 2"', -3.0),
    ],
)
def test_motor_moves_the_joint_as_in_mujoco(tmp_path, attributes, gain):
    text = text_of(f'<motor joint="j" {attributes}/>')
    compare(here(tmp_path, text, torque=3.0 * gain), in_mujoco(text, 3.0))


@pytest.mark.parametrize("kind", ["filter", "filterexact"])
def test_filter_of_a_motor_is_its_lag(tmp_path, kind):
    state = f'dyntype="{kind}" dynprm="0.02" actearly="true"'
    text = text_of(f'<general joint="j" gainprm="2" {state}/>')
    compare(here(tmp_path, text, torque=6.0), in_mujoco(text, 3.0), torque=False)
    cylinder = text_of('<cylinder joint="j" area="2" timeconst="0.02" ctrlrange="-9 9"/>')
    compare(here(tmp_path, cylinder, torque=6.0), in_mujoco(cylinder, 3.0), torque=False)


def test_attributes_of_default_classes_count(tmp_path):
    before = f'<default><default class="s"><motor {DELAYED} armature="0.1"/></default></default>'
    text = text_of('<motor class="s" joint="j"/>', before=before)
    compare(here(tmp_path, text, torque=3.0), in_mujoco(text, 3.0))


@pytest.mark.parametrize(
    ("actuator", "control", "target"),
    [
        ('<position joint="j" kp="100" kv="8"/>', 0.3, (0.3, 0.0)),
        ('<position joint="j" kp="100" dampratio="0.7" armature="0.15"/>', 0.3, (0.3, 0.0)),
        (f'<position joint="j" kp="100" kv="8" forcerange="-15 15" {DELAYED}/>', 0.3, (0.3, 0.0)),
        ('<position joint="j" kp="20" kv="2" gear="2" inheritrange="1"/>', 0.6, (0.3, 0.0)),
        ('<velocity joint="j" kv="1" gear="2"/>', 1.0, (0.0, 0.5)),
        ('<pid joint="j" kp="100" kv="8"/>', (0.3, 0.5), (0.3, 0.5)),
        ('<pid joint="j" kp="100" dampratio="1" input="pos"/>', 0.3, (0.3, 0.0)),
        ('<general joint="j" biastype="affine" gainprm="100" biasprm="0 -100 -8"/>', 0.3,
         (0.3, 0.0)),
        ('<dcmotor joint="j" resistance="2" motorconst="0.5" controller="100 0 8"'
         ' input="pos vel"/>', (0.3, 0.0), (0.3, 0.0)),
    ],
)  # fmt: skip
def test_servo_is_the_loop_of_its_drive(tmp_path, actuator, control, target):
    """Our targets of position move on with those of velocity; MuJoCo's stand."""
    text = text_of(actuator)
    theirs = in_mujoco(text, control)
    if target[1] and target[0]:  # a damper towards v*: the same as one towards 0 and a torque
        ours = here(tmp_path, text, torque=8.0 * target[1], target=(target[0], 0.0))
    else:
        ours = here(tmp_path, text, target=target)
    compare(ours, theirs)


@pytest.mark.parametrize(
    "more", ["", 'armature="0.0005" damping="0.0002"', 'inductance="0.01 0"', 'saturation="0.1"']
)
def test_dc_motor_at_full_voltage_follows_its_torque_over_speed(tmp_path, more):
    text = text_of(
        f'<dcmotor joint="j" motorconst="0.05" resistance="2" gear="10" ctrlrange="-24 24" {more}/>'
    )
    compare(here(tmp_path, text, torque=900.0), in_mujoco(text, 24.0), torque=False)


def test_nominal_point_of_a_dc_motor_is_read(tmp_path):
    text = text_of('<dcmotor joint="j" nominal="24 0.6 40" gear="10" ctrlrange="-24 24"/>')
    robot = read(tmp_path, text)
    assert robot.effort_limits_nm.tolist() == pytest.approx([6.0])
    assert robot.velocity_limits_rad_s.tolist() == pytest.approx([4.0])
    compare(here(tmp_path, text, torque=900.0), in_mujoco(text, 24.0), torque=False)


def test_shorted_motor_brakes(tmp_path):
    text = text_of(
        '<motor joint="j"/><dcmotor joint="j" motorconst="0.5" resistance="2" gear="3"'
        ' input="none"/>'
    )
    compare(here(tmp_path, text, torque=3.0), in_mujoco(text, 3.0), torque=False)


def test_friction_and_cogging_of_a_dc_motor_are_those_of_mujoco(tmp_path):
    text = text_of(
        '<motor joint="j"/><dcmotor joint="j" motorconst="0" resistance="1" gear="2" input="none"'
        ' lugre="500 1 0.2 0.5 0.6" cogging="0.1 8 0"/>'
    )
    robot = read(tmp_path, text)
    friction = drives_of(robot).friction
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    for speed in (0.05, 0.2, 0.6):
        for _ in range(4000):  # until the bristles are bent
            data.qvel[:], data.qpos[:] = speed, 0.0
            mujoco.mj_step(model, data)
        dry = friction["coulomb_nm"][0] + friction["stribeck_nm"][0] * np.exp(
            -((speed / friction["stribeck_velocity_rad_s"][0]) ** 2)
        )
        assert dry == pytest.approx(-data.qfrc_actuator[0], rel=2e-3)
    data.qvel[:], data.act[:] = 0.0, 0.0
    drives, angles = robot.drives, np.linspace(0.0, 0.5, 200)
    found = []
    for data.qpos[0] in angles:
        mujoco.mj_forward(model, data)
        found.append(data.qfrc_actuator[0])
    wave = drives.cogging_nm[0] * np.sin(drives.cogging_periods[0] * angles)
    np.testing.assert_allclose(found, wave, atol=1e-9)


LATE = '<sensor><jointpos joint="j" name="encoder" delay="0.01" nsample="40"/></sensor>'


@pytest.mark.parametrize(
    ("actuator", "words"),
    [
        ('<motor joint="j" damping="1 2 3"/>', "quadratic and cubic damping of actuator 0"),
        ('<motor joint="j" ctrlrange="-1 5"/>', "ctrlrange of actuator 0: not symmetric"),
        ('<motor joint="j" forcerange="-1 5" name="m"/>', "forcerange of actuator m: not"),
        ('<position joint="j" kp="9" timeconst="0.02"/>', "timeconst of actuator 0: it filters"),
        (f'<position joint="j" kp="9" {DELAYED} interp="cubic"/>', "interp of actuator 0"),
        ('<motor joint="j" delay="0.02" nsample="20"/>',
         "delay of actuator 0: 20 ms, beyond the 5 ms that nsample × timestep keep"),
        ('<intvelocity joint="j" kp="9" actrange="-1 1"/>', "dyntype integrator of actuator 0"),
        ('<damper joint="j" kv="3" ctrlrange="0 1"/>', "damping by its control"),
        ('<cylinder joint="j" bias="3 0 0" ctrlrange="-5 5"/>', "constant force (bias)"),
        ('<general joint="j" biastype="affine" gainprm="9" biasprm="0 9 0"/>',
         "negative stiffness of actuator 0"),
        ('<muscle joint="j" force="100" lengthrange="0.1 1"/>', "gaintype muscle of actuator 0"),
        ('<pid joint="j" kp="9" ki="3" slewmax="2"/>', "ki of actuator 0"),
        ('<pid joint="j" kp="9" ki="3" slewmax="2"/>', "slewmax of actuator 0"),
        ('<dcmotor joint="j" nominal="24 6 4" thermal="1 2 0 0.004 25 25"/>',
         "thermal of actuator"),
        ('<dcmotor joint="j" nominal="24 6 4"/>', "voltage input of actuator 0"),
        ('<dcmotor joint="j" nominal="24 6 4" controller="5 1 1 2" input="pos"/>',
         "controller ki of actuator 0"),
        ('<dcmotor joint="j" nominal="24 6 4" inductance="0.01 0" saturation="0 0 50"/>',
         "saturation current_rate of actuator 0"),
        ('<dcmotor joint="j" nominal="24 6 4" lugre="50 1 0.2 0.3 0.1"/>', "lugre stiffness"),
        ('<dcmotor joint="j" nominal="24 6 4" cogging="0.1 8 0.3"/>', "cogging phase"),
        ('<motor joint="j"/><adhesion body="arm" ctrlrange="0 1"/>', "adhesion of actuator 1"),
        ('<motor joint="j"/><motor joint="j" group="2" gear="9"/>', "group of actuator 1"),
        ('<motor joint="j"/>', "delays of sensors encoder (delay 0.01 s): left out; link.uplink"),
    ],
)  # fmt: skip
def test_what_is_not_carried_over_is_named_with_the_actuator(tmp_path, actuator, words):
    after = LATE if "sensors" in words else ""
    before = '<option actuatorgroupdisable="2"/>' if "group" in words else ""
    robot = read(tmp_path, text_of(actuator, before=before, after=after))
    assert any(words in each for each in robot_warnings(at_rest(robot)))
    assert not any("sensors" in each for each in robot.warnings) or after


def test_plain_actuators_have_no_such_sentence(tmp_path):
    actuator = '<position joint="j" kp="9" kv="1" ctrlrange="-5 5" forcerange="-5 5"/>'
    assert not [each for each in read(tmp_path, text_of(actuator)).warnings if "actuator" in each]


def test_disabled_actuator_has_no_torque(tmp_path):
    text = text_of(
        '<motor joint="j" ctrlrange="-1 1"/><motor joint="j" group="2" ctrlrange="-9 9"/>',
        before='<option actuatorgroupdisable="2"/>',
    )
    assert read(tmp_path, text).effort_limits_nm.tolist() == [1.0]


def test_different_delays_of_joints_are_named_and_the_largest_is_used(tmp_path):
    second = """<body name="fore" pos="0.4 0 0"><joint name="k" axis="0 0 1"/>
      <geom size="0.05" mass="1"/></body></body></worldbody>"""
    text = text_of(f'<motor joint="j" {DELAYED}/><motor joint="k"/>')
    robot = read(tmp_path, text.replace("</body>\n</worldbody>", second))
    assert robot.joints == 2
    assert starter_scenario(robot)["plant"]["actuator"]["delay_ms"] == 20.0
    words = "delay of actuators: 20 of j, 0 of k: the largest, 20 ms is that of all joints here"
    assert any(words in each for each in robot.warnings)

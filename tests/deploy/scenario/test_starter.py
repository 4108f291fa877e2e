"""An arm's file alone: a first scenario, what it estimates, and what it warns of."""

import numpy as np
import pytest

from bus_schema.robot_description import load_robot
from controller.manipulator_model import ManipulatorModel, largest_load_kg
from deploy.judge.conditions import conditions_of_runs
from deploy.run.execute import execute
from deploy.scenario.checking.warnings import reference_torques, scenario_warnings
from deploy.scenario.scenario import build_setup, load_setup
from deploy.scenario.starter import starter_scenario, torque_limits
from deploy.study.doubts import TIME_CONSTANTS
from deploy.study.quantities import RAMP_FOR_S, RAMP_FROM_S
from tests.arms import ARMS, shipped_arm

ARM = """<robot name="two"><link name="base"/>
<link name="link0"><inertial><mass value="3"/><origin xyz="0.25 0 0"/>
<inertia ixx="0.01" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="link1"><inertial><mass value="2"/><origin xyz="0.25 0 0"/>
<inertia ixx="0.01" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="joint0" type="revolute"><parent link="base"/><child link="link0"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="{}" velocity="2"/></joint>
<joint name="joint1" type="revolute"><parent link="link0"/><child link="link1"/>
<origin xyz="0.5 0 0"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="{}" velocity="2"/></joint></robot>"""


@pytest.fixture
def two_links(tmp_path):
    """A URDF of two links that pitch, of 3 and 2 kg, 0.5 m each."""

    def write(*efforts):
        file = tmp_path / "two.urdf"
        file.write_text(ARM.format(*efforts))
        return file

    return write


@pytest.mark.parametrize("name", ARMS)
def test_a_starter_moves_within_every_limit(name, tmp_path):
    robot = shipped_arm(name)
    setup = build_setup(starter_scenario(robot), tmp_path / "mine.yaml")
    times_s = np.linspace(0.0, setup.scenario.duration_s, 500)
    rotors = setup.scenario.plant.actuator.rotor_inertia(robot.joints)
    rated = setup.scenario.plant.actuator.saturation_nm
    usage = np.abs(reference_torques(setup, times_s)) / rated
    # 70 % of the largest torques; 5 % of dry friction; at 30 % of top speed 30 % of 20 % of viscous
    assert usage.max() <= 0.82
    motion = np.empty((3, robot.joints))
    follow, speeds = setup.reference.onto(*motion), []
    for time_s in times_s:
        follow(float(time_s))
        speeds.append(np.abs(motion[1]).copy())
    assert (np.max(speeds, axis=0) <= 0.31 * robot.velocity_limits_rad_s).all()
    assert rotors.all()
    full_s = RAMP_FROM_S + RAMP_FOR_S  # a margin of a running loop is tested without --duration
    assert setup.scenario.duration_s >= full_s + TIME_CONSTANTS / setup.scenario.funnel.rate_per_s


def test_estimated_friction_is_within_the_spread_of_two_real_arms(two_links):
    friction = load_setup(str(two_links(60, 20))).scenario.plant.friction
    assert 0.036 <= friction.coulomb_share[0] <= 0.061  # a UR10e's and a UR10's, by their torques
    assert (friction.viscous_share_s >= 0.043).all()
    assert (friction.viscous_share_s <= 0.066).all()


def test_viscous_friction_of_a_fast_joint_leaves_most_of_its_torque(two_links):
    file = two_links(60, 20)
    file.write_text(file.read_text().replace('velocity="2"', 'velocity="10"'))
    friction = load_setup(str(file)).scenario.plant.friction
    assert friction.viscous_share_s.tolist() == [0.02, 0.02]  # 20 % at 10 rad/s


def test_a_strangers_arm_keeps_its_bounds_over_a_delay_with_a_wrong_model(two_links):
    delay = ["controller.delay_compensation.enabled=true", "controller.model_scale=0.8"]
    delay += ["link.uplink.delay_ms=24", "link.downlink.delay_ms=24"]
    setup = load_setup(str(two_links(60, 20)), delay)
    assert setup.scenario.controller.law == "fixed_time_adaptive"
    assert execute(setup).summary["verdict"] == "kept"


def test_what_is_estimated_is_called_an_estimate(two_links):
    file = two_links(60, 20)
    setup = load_setup(str(file))
    assert setup.scenario.plant.actuator.rotor_inertia_kg_m2.tolist() == [0.48, 0.16]
    assert any("ESTIMATED" in text for text in scenario_warnings(setup))
    assert "rotor inertia ESTIMATED" in conditions_of_runs([setup], {})["drives"]


def test_what_the_file_knows_of_its_motors_is_taken(two_links):
    file = two_links(60, 20)
    known = """<transmission><joint name="joint1"/><actuator><mechanicalReduction>100
    </mechanicalReduction><drake:rotor_inertia xmlns:drake="drake.mit.edu" value="2e-5"/></actuator>
    </transmission></robot>"""
    text = file.read_text().replace("</robot>", known)
    friction = '<axis xyz="0 1 0"/><dynamics friction="0.7" damping="4"/>'
    file.write_text(text.replace('<axis xyz="0 1 0"/>', friction, 1))
    setup = load_setup(str(file))
    plant = setup.scenario.plant
    assert plant.actuator.rotor_inertia_kg_m2.tolist() == [0.48, 0.2]
    assert plant.friction.coulomb_nm.tolist() == [0.7, 0.0]
    assert plant.friction.coulomb_share.tolist() == [0.0, 0.05]
    assert plant.friction.viscous_share_s.tolist() == [0.0, 0.06]
    assert "from the arm's file and elsewhere ESTIMATED" in setup.scenario.robot.drive_data
    assert plant.friction.viscous_nm_s.tolist() == [4.0, 0.0]
    # A motor of 60 N m moves nothing against 13 N m, and a joint that is damped by 300 N m s/rad.
    file.write_text(file.read_text().replace("0.7", "13").replace('damping="4"', 'damping="300"'))
    friction = load_setup(str(file)).scenario.plant.friction
    assert friction.coulomb_share.tolist() == [0.05]
    assert not friction.viscous_nm_s.any()


@pytest.mark.parametrize("name", ["iiwa_motors", "panda_motors", "ur10e_motors"])
def test_a_shipped_arm_with_motors_keeps_its_bounds_over_a_delay(name):
    delay = ["controller.delay_compensation.enabled=true", "duration_s=6"]
    delay += ["link.uplink.delay_ms=24", "link.downlink.delay_ms=24"]
    setup = load_setup(name, delay)
    assert setup.scenario.robot.drive_data
    assert starter_scenario(setup.robot)["robot"]["drive_data"] == setup.scenario.robot.drive_data
    assert execute(setup).summary["verdict"] == "kept"


def test_a_shipped_arm_with_held_joints_keeps_the_motors_of_the_others():
    names = ["elbow_joint", "wrist_1_joint"]
    robot = load_robot(shipped_arm("ur10e").path, names, hold={"shoulder_lift_joint": -1.0})
    whole, some = (starter_scenario(each)["plant"] for each in (shipped_arm("ur10e"), robot))
    for key in ("rotor_inertia_kg_m2", "saturation_nm"):
        assert some["actuator"][key] == whole["actuator"][key][2:4]
    assert some["friction"]["coulomb_nm"] == whole["friction"]["coulomb_nm"][2:4]
    assert some["friction"]["coulomb_share"] == whole["friction"]["coulomb_share"]


def test_reference_beyond_the_largest_torque_causes_a_warning(two_links):
    # Held out flat, the first joint carries 9.81 (3 · 0.25 + 2 · 0.75) = 22 N m.
    flat = {"kind": "minimum_jerk", "waypoints": [{"time_s": 0, "position_rad": 0.0}]}
    values = {"name": "flat", "duration_s": 1, "reference": flat}
    values["robot"] = {"urdf": str(two_links(11.0, 20.0))}
    (text,) = [each for each in scenario_warnings(build_setup(values, two_links(11.0, 20.0)))
               if "the reference needs" in each]  # fmt: skip
    assert "joint0 to deliver 22.1 N m at 0.00 s, 2.01 times its largest torque 11 N m" in text


def test_payload_is_a_share_of_what_the_arm_holds_up(two_links):
    # Stretched out, joint 0 has 40 − 22.07 N m left for the 9.81 · 0.5 N m of a kg at the tip, the
    # origin of the last link: 3.66 kg, less than the 5 kg that move.
    robot = load_robot(two_links(40.0, 20.0))
    assert largest_load_kg(robot, robot.effort_limits_nm) == pytest.approx(3.66, rel=0.02)
    setup = load_setup(str(robot.path), ["plant.payload_share=0.5"])
    assert setup.scenario.plant.payload_kg == pytest.approx(1.83, rel=0.02)
    strong = load_robot(two_links(1e6, 1e6))
    assert largest_load_kg(strong, strong.effort_limits_nm) == pytest.approx(5.0)


def test_unknown_torques_are_estimated_from_the_arms_weight(two_links):
    file = two_links(60.0, 20.0)
    file.write_text(file.read_text().replace(' effort="60.0"', ""))
    robot = load_robot(file)
    # Three times the 22.07 N m that hold it out flat; 500 postures come close to that.
    np.testing.assert_allclose(torque_limits(robot), [66.2, 20.0], rtol=0.02)
    assert "largest torques ESTIMATED" in starter_scenario(robot)["robot"]["drive_data"]


def test_gears_bend_as_a_first_resonance_asks(two_links):
    setup = load_setup(str(two_links(60, 20)), ["plant.actuator.gear_resonance_hz=15"])
    actuator = setup.scenario.plant.actuator
    assert actuator.encoder_side == "motor"  # through the link's no law can damp the gear
    assert not any("encoder_side" in text for text in scenario_warnings(setup))
    by_link = ["plant.actuator.gear_resonance_hz=15", "plant.actuator.encoder_side=link"]
    warned = scenario_warnings(load_setup(str(setup.source), by_link))
    assert any("encoder_side: link measures on the output side" in text for text in warned)
    stiffness = actuator.gear_stiffness_nm_rad
    assert stiffness[0] == pytest.approx(3.0 * stiffness[1])  # as the largest torques
    mass = ManipulatorModel(setup.robot).mass_matrix(setup.start_position_rad)
    slowest = np.linalg.eigvals(np.linalg.inv(mass) @ np.diag(stiffness)).min()
    assert np.sqrt(slowest) / (2 * np.pi) == pytest.approx(15.0)


def test_torque_of_the_default_law_does_not_chatter_with_derived_gains():
    delay = ["controller.delay_compensation.enabled=true", "duration_s=3", "metrics.from_s=1"]
    delay += ["link.uplink.delay_ms=8", "link.downlink.delay_ms=8"]
    summary = execute(load_setup("panda_motors", delay)).summary
    assert max(summary["torque"]["share_above_50_hz"]) < 0.02
    assert max(summary["tracking"]["rms_rad"]) < 5e-5

"""Implausible values of arms, which are named with their numbers, and estimates beside them."""

import re

import numpy as np
import pytest

from bus_schema.robot_description import load_robot
from deploy.cli.robot import at_rest, robot_warnings
from deploy.scenario.checking.plausibility import loads_of
from deploy.scenario.checking.warnings import (
    estimated_rotor_warnings,
    scenario_warnings,
    tenth_of_rotors,
)
from deploy.scenario.scenario import build_setup, load_setup
from deploy.scenario.starter import starter_scenario, torque_limits
from tests.arms import ARMS, shipped_arm
from tests.deploy.scenario.test_starter import ARM


@pytest.fixture
def arm(tmp_path):
    """Two links that pitch, of 3 and 2 kg, 0.5 m each; texts replace others of the file."""

    def write(*efforts, **changes):
        text = ARM.format(*efforts)
        for old, new in changes.items():
            text = text.replace(OLD[old], new)
        file = tmp_path / "two.urdf"
        file.write_text(text)
        return file

    return write


OLD = {
    "axis": '<axis xyz="0 1 0"/>',
    "first_axis": '<child link="link0"/><axis xyz="0 1 0"/>',
    "effort": ' effort="None"',
}


def warnings_of(file):
    robot = load_robot(file, hold_grippers=True)
    return robot_warnings(at_rest(robot))


@pytest.mark.parametrize("name", ARMS)
def test_shipped_arms_have_no_implausible_values(name):
    """But for the 300 N m of all joints of pybullet's iiwa, where the real wrist has 40."""
    warned = robot_warnings(at_rest(shipped_arm(name)))
    template = [each for each in warned if "(300)" in each and "links around a wrist" in each]
    assert len(template) == (name == "iiwa")
    warned = [each for each in warned if each not in template]
    for word in ("probably", "damping", "gravity needs", "centre of mass", "same mass"):
        assert not any(word in each for each in warned)


def test_torque_below_gravity_is_named_with_posture_and_both_numbers(arm):
    # Held out flat, the first joint carries 9.81 (3 · 0.25 + 2 · 0.75) = 22.07 N m.
    (warned,) = [each for each in warnings_of(arm(11, 20)) if "gravity needs" in each]
    assert "joint0 (11 of 22.0" in warned
    assert "joint0 at the joint positions" in warned
    assert not any("gravity needs" in each for each in warnings_of(arm(23, 20)))


def test_margin_of_an_arm_that_cannot_hold_itself_up_is_refused(arm, funnel_hil, monkeypatch):
    monkeypatch.chdir(arm(11, 20).parent)
    output = funnel_hil.output(
        "margin", "two.urdf", "--set", "limits.torque_nm=[0.5, 20.0]", code=2
    )
    assert "joint0 cannot hold the arm up on its reference" in output
    assert "N m at" in output
    assert "its largest torque is 0.5 N m" in output


def test_placeholder_torque_is_named_and_no_base_of_estimates(arm):
    file = arm(50000, 20)
    (warned,) = [each for each in warnings_of(file) if "placeholder" in each]
    assert "joint0 (50000)" in warned
    values = starter_scenario(load_robot(file))
    assert values["limits"]["torque_nm"] == pytest.approx([66.2, 20.0], rel=0.02)
    assert values["plant"]["actuator"]["rotor_inertia_kg_m2"][0] == pytest.approx(0.53, rel=0.02)
    assert "largest torques ESTIMATED" in values["robot"]["drive_data"]
    assert not any("probably" in each for each in scenario_warnings(load_setup(str(file))))


def row(masses, efforts, *, length="0.3", vertical=()):
    """An arm of joints in a row; of those that are listed the axis is vertical."""
    text = '<robot name="r"><link name="l0"/>'
    for i, (kg, effort) in enumerate(zip(masses, efforts, strict=True)):
        axis, limit = "0 0 1" if i in vertical else "0 1 0", f'effort="{effort}" velocity="3"'
        text += f"""<link name="l{i + 1}"><inertial><origin xyz="0.1 0 0"/><mass value="{kg}"/>
          <inertia ixx="0.002" iyy="0.004" izz="0.004" ixy="0" ixz="0" iyz="0"/></inertial></link>
          <joint name="j{i + 1}" type="revolute"><parent link="l{i}"/><child link="l{i + 1}"/>
          <origin xyz="{length if i else 0} 0 0"/><axis xyz="{axis}"/>
          <limit lower="-2" upper="2" {limit}/></joint>"""
    return text + "</robot>"


@pytest.fixture
def read(tmp_path):
    def of(text):
        (tmp_path / "row.urdf").write_text(text)
        return load_robot(tmp_path / "row.urdf", hold_grippers=True)

    return of


HEAVY = (40, 40, 15, 5, 5, 1.5)


@pytest.mark.parametrize(
    ("masses", "efforts", "named"),
    [
        (HEAVY, (2000, 1500, 1500, 1000, 1000, 1000), "j4 (1000), j5 (1000), j6 (1000)"),
        ((4, 4, 3, 2, 1.5, 0.3), (300,) * 6, "j1 (300), j2 (300), j3 (300), j4 (300) and 2 more"),
        ((0.8, 0.7, 0.3, 0.2, 0.14), (100,) * 5, "j1 (100)"),
        ((4, 8, 4, 2, 2, 0.4), (330, 330, 150, 56, 56, 56), ""),  # about a UR10e
        ((0.1, 0.1, 0.1, 0.1, 0.1), (3.35,) * 5, ""),  # an SO-101, with one kind of servo
    ],
)  # fmt: skip
def test_template_torques_below_the_multiple_of_gravity_are_named(read, masses, efforts, named):
    robot = read(row(masses, efforts, length="0.2"))
    found = [each for each in robot_warnings(at_rest(robot)) if "placeholder" in each]
    assert bool(found) is bool(named)
    assert all(named in each for each in found)
    torques = torque_limits(robot)
    assert (torques <= robot.effort_limits_nm).all()
    if named:
        assert torques[-1] < 0.5 * efforts[-1]
    else:
        assert torques.tolist() == list(efforts)


@pytest.mark.parametrize("first", [2000, 8000])
def test_replacement_never_raises_a_torque_nor_beyond_what_links_bear(read, first):
    efforts = (2000, first, 8000, 2000, 3000, 1000)
    robot = read(row((19, 19, 7, 2.4, 2.4, 0.7), efforts))
    torques = torque_limits(robot)
    assert (torques < robot.effort_limits_nm).all()
    around_kg = np.array([19 + 7 + 2.4 + 2.4 + 0.7 + 19, 7 + 19 + 2.4 + 2.4 + 0.7,
                          2.4 + 2.4 + 7 + 0.7, 2.4 + 2.4 + 0.7])  # fmt: skip
    assert (torques[2:] <= 50.0 * around_kg).all()
    rotors = starter_scenario(robot)["plant"]["actuator"]["rotor_inertia_kg_m2"]
    assert rotors == pytest.approx(0.008 * torques, rel=1e-3)


def test_waist_has_the_torque_that_its_arms_need_by_inertia(read):
    """As the shoulders, which are vertical too: in the ratio of inertias to the joints after."""
    arm = row((0.2,) * 4, (0,) * 4, length="0.08", vertical=(0,))
    arm = arm.replace('<robot name="r"><link name="l0"/>', "").replace("</robot>", "")
    arm = arm.replace('link="l0"', 'link="waist"')
    sides = "".join(re.sub('"([lj][0-9])', rf'"{side}_\1', arm) for side in ("left", "right"))
    waist = """<link name="base"/><link name="waist"><inertial><origin xyz="0 0 0"/>
      <mass value="1"/><inertia ixx="0.002" iyy="0.002" izz="0.002" ixy="0" ixz="0" iyz="0"/>
      </inertial></link><joint name="yaw" type="revolute"><parent link="base"/>
      <child link="waist"/><axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="0" velocity="3"/>
      </joint>"""
    robot = read(f'<robot name="r">{sides}{waist}</robot>')
    assert robot.joint_names[-1] == "yaw"
    inertia = loads_of(robot).inertia_kg_m2
    torques = torque_limits(robot)
    assert torques[-1] / inertia[-1] == pytest.approx(torques[1] / inertia[1], rel=1e-6)
    # The second joint of an arm lifts 0.2 kg each at 0.1, 0.18 and 0.26 m, three times.
    assert torques[1] == pytest.approx(3 * 9.81 * 0.2 * (0.1 + 0.18 + 0.26), rel=0.02)


def test_mass_outside_of_all_real_arms_is_named_with_theirs(read):
    light = read(row((0.02,) * 6, (1,) * 6))
    (warned,) = [each for each in robot_warnings(at_rest(light)) if "real arms have" in each]
    # 0.12 kg over 5 · 0.3 + 2 · 0.1 = 1.7 m; 3 to 150 kg/m³ would be 15 to 737 kg.
    assert "0.12 kg move at a reach of 1.7 m, where real arms have 15 to 737 kg" in warned
    fine = read(row((10, 8, 6, 4, 2, 1), (300, 300, 200, 50, 50, 30)))
    assert not any("real arms have" in each for each in robot_warnings(at_rest(fine)))


def test_rotor_with_more_inertia_than_the_stretched_arm_is_named_and_estimated(read):
    """0.23 kg at 1.2 m are 0.33 kg m²."""
    armature = "".join(
        f'<transmission name="t{i}"><joint name="j{i}"/><actuator name="a">'
        f"<rotor_inertia>{kg_m2}</rotor_inertia></actuator></transmission>"
        for i, kg_m2 in enumerate((5.0, 0.1, 0.1, 0.1), start=1)
    )
    text = row((0.1, 0.05, 0.05, 0.03), (2, 2, 1, 0.5), length="0.33")
    robot = read(text.replace("</robot>", f"{armature}</robot>"))
    (warned,) = [each for each in robot_warnings(at_rest(robot)) if "rotor inertia of" in each]
    assert "j1 (5 kg m²)" in warned
    assert "j2" not in warned
    rotors = starter_scenario(robot)["plant"]["actuator"]["rotor_inertia_kg_m2"]
    assert rotors == pytest.approx([0.016, 0.1, 0.1, 0.1])


def test_vertical_joint_has_the_torque_of_its_neighbour_by_inertia(arm):
    upright = '<child link="link0"/><axis xyz="0 0 1"/>'
    robot = load_robot(arm(None, 20, first_axis=upright, effort=""))
    # Inertias: 0.1 + 3 · 0.25² + 2 · 0.75² = 1.41 kg m² of 0.05 + 2 · 0.25² = 0.175
    assert torque_limits(robot) == pytest.approx([20.0 * 1.4125 / 0.175, 20.0], rel=0.01)


def test_damping_that_takes_the_torque_is_named(arm):
    damped = '<axis xyz="0 1 0"/><dynamics damping="{}"/>'
    file = arm(60, 60, axis=damped.format(15))
    for warnings in (warnings_of(file), scenario_warnings(load_setup(str(file)))):
        (warned,) = [each for each in warnings if "damping" in each]
        assert "joint0 (15 N m s/rad, 50 % at 2 rad/s)" in warned
    # It is not used if it is far too large; the warning stays with the file.
    file = arm(60, 60, axis=damped.format(300))
    assert any("damping" in each for each in warnings_of(file))
    assert not any("damping" in each for each in scenario_warnings(load_setup(str(file))))
    assert not any("damping" in each for each in warnings_of(arm(60, 60, axis=damped.format(2))))


def test_rotors_of_the_file_are_no_estimate(arm):
    # The starter estimates 0.008 kg m² per N m; what is the file's own stays.
    assert tenth_of_rotors(load_setup(str(arm(60, 20)))).endswith("=[0.048, 0.016]")
    assert tenth_of_rotors(load_setup("paper_arm")) is None
    values = ["robot.drive_data=rotor inertia ESTIMATED as 1"]
    assert tenth_of_rotors(load_setup("paper_arm", values)) is None  # which has no rotors


def test_rotors_that_an_override_gives_are_estimated_no_longer(arm):
    given = load_setup(str(arm(60, 20)), ["plant.actuator.rotor_inertia_kg_m2=[0.3, 0.1]"])
    assert given.drive_data.startswith("rotor inertia as given, dry friction ESTIMATED")
    assert tenth_of_rotors(given) is None


def test_a_tenth_of_estimated_rotors_has_its_command(arm):
    setup = load_setup(str(arm(60, 20)))
    (warned,) = estimated_rotor_warnings(setup)
    assert "--set 'plant.actuator.rotor_inertia_kg_m2=[0.048, 0.016]'" in warned
    tenth = load_setup(str(arm(60, 20)), ["plant.actuator.rotor_inertia_kg_m2=[0.048, 0.016]"])
    np.testing.assert_allclose(tenth.scenario.plant.actuator.rotor_inertia_kg_m2, [0.048, 0.016])
    assert estimated_rotor_warnings(tenth) == []
    assert not any("margin" in each for each in scenario_warnings(setup))  # of every command


def test_an_arm_without_largest_torques_has_a_first_scenario_that_is_warned_of(arm):
    robot = load_robot(arm(0, 0), hold_grippers=True)
    setup = build_setup(starter_scenario(robot), robot.path)
    assert setup.scenario.plant.actuator.saturation_nm is not None
    assert any("ESTIMATED" in each for each in scenario_warnings(setup))

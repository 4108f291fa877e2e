"""Implausible values of arms, which are named with their numbers, and estimates beside them."""

import numpy as np
import pytest

from bus_schema.robot_description import load_robot
from deploy.cli.robot import at_rest, robot_warnings
from deploy.scenario.checking.warnings import scenario_warnings, tenth_of_rotors
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
    warned = robot_warnings(at_rest(shipped_arm(name)))
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
    (warned,) = [e for e in scenario_warnings(load_setup(str(arm(60, 20)))) if "rotors" in e]
    assert "--set 'plant.actuator.rotor_inertia_kg_m2=[0.048, 0.016]'" in warned
    tenth = load_setup(str(arm(60, 20)), ["plant.actuator.rotor_inertia_kg_m2=[0.048, 0.016]"])
    np.testing.assert_allclose(tenth.scenario.plant.actuator.rotor_inertia_kg_m2, [0.048, 0.016])


def test_an_arm_without_largest_torques_has_a_first_scenario_that_is_warned_of(arm):
    robot = load_robot(arm(0, 0), hold_grippers=True)
    setup = build_setup(starter_scenario(robot), robot.path)
    assert setup.scenario.plant.actuator.saturation_nm is not None
    assert any("ESTIMATED" in each for each in scenario_warnings(setup))

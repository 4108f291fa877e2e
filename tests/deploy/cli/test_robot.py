"""`funnel-hil robot`, and what commands say of arms."""

import re

import numpy as np
import pytest

from deploy.scenario.effective import write_scenario
from deploy.scenario.referenced_files import ROBOTS
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError
from funnel_hil import Scenario
from tests.arms import INSTALLED, PAPER_ARM, needs_bullet, needs_pybullet_data
from tests.bus_schema.urdf.test_chains import TWO_ARMS

XACRO = """<robot name="test" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:property name="length" value="0.4"/>
  <xacro:include filename="$(find some_robot)/links.xacro"/>
  <link name="base"/>
  <xacro:rod name="arm" mass="${2 * 1.5}"/>
  <joint name="hinge" type="revolute">
    <parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="{effort}" velocity="0"/>
  </joint>
</robot>"""
LINKS = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:macro name="rod" params="name mass">
    <link name="${name}"><inertial><origin xyz="${length/2} 0 0"/><mass value="${mass}"/>
      <inertia ixx="0.001" iyy="0.04" izz="0.04" ixy="0" ixz="0" iyz="0"/></inertial></link>
  </xacro:macro>
</robot>"""
SCENARIO = """
name: test
duration_s: 0.05
robot: {urdf: some_robot/urdf/arm.urdf.xacro}
reference: {kind: minimum_jerk, waypoints: [{time_s: 0, position_rad: 0.0}]}
metrics: {from_s: 0.01}
"""


@pytest.fixture
def folder(tmp_path):
    urdf = tmp_path / "some_robot" / "urdf"
    urdf.mkdir(parents=True)
    (tmp_path / "some_robot" / "links.xacro").write_text(LINKS)
    (tmp_path / "some_robot" / "package.xml").write_text("<package/>")
    (urdf / "arm.urdf.xacro").write_text(XACRO.replace("{effort}", "5"))
    (tmp_path / "test.yaml").write_text(SCENARIO)
    return tmp_path


def test_a_xacro_file_is_an_arm_like_any_other(folder):
    setup = load_setup(str(folder / "test.yaml"))
    assert setup.robot.joint_names == ("hinge",)
    # m (l/2)² + I = 3 × 0.2² + 0.04
    assert setup.governing_inertia_kg_m2[0] == pytest.approx(0.16)
    written = folder / "results" / "scenario.yaml"
    written.parent.mkdir()
    write_scenario(setup, written)
    (copy,) = written.parent.glob("*.urdf")
    assert "xacro:" not in copy.read_text()
    assert load_setup(str(written)).governing_inertia_kg_m2[0] == pytest.approx(0.16)


@pytest.mark.parametrize("before", ["", '<?xml version="1.0"?>\n', "\n<!-- an arm: of mine -->\n"])
def test_urdf_instead_of_a_study_is_refused_with_a_hint(folder, funnel_hil, before):
    arm = folder / "arm.urdf"
    arm.write_text(before + XACRO)
    output = funnel_hil.output("sweep", arm, code=2)
    assert f"{arm}: must be a mapping of keys to values in YAML, but is XML. " in output
    assert "belongs under robot.urdf of a scenario; " in output
    assert output.endswith(f"funnel-hil robot {arm} shows it\n")


def test_an_arm_is_a_scenario_and_can_be_written_as_one(folder, funnel_hil, monkeypatch):
    monkeypatch.chdir(folder)
    output = funnel_hil.output("robot", PAPER_ARM.path, "--scenario", "--out", "mine.yaml")
    assert "funnel-hil margin mine.yaml" in output
    of_file, of_arm = (load_setup(str(each)) for each in ("mine.yaml", PAPER_ARM.path))
    assert of_file.gains.k_1.tolist() == of_arm.gains.k_1.tolist()
    rotors = of_file.scenario.plant.actuator.rotor_inertia_kg_m2
    np.testing.assert_allclose(rotors, 0.008 * PAPER_ARM.effort_limits_nm, rtol=1e-3)
    output = funnel_hil.output("robot", PAPER_ARM.path, "--scenario", "--out", "mine.yaml", code=2)
    assert "mine.yaml: cannot be written: File exists; --out names another" in output


def test_error_of_xacro_names_the_file(folder):
    path = folder / "some_robot" / "urdf" / "arm.urdf.xacro"
    path.write_text(path.read_text().replace("2 * 1.5", "twice"))
    with pytest.raises(ScenarioError, match=r"arm\.urdf\.xacro: xacro: .*twice"):
        load_setup(str(folder / "test.yaml"))
    path.write_text(path.read_text().replace("find some_robot", "find other_robot"))
    with pytest.raises(ScenarioError, match=r"no folder 'other_robot'"):
        load_setup(str(folder / "test.yaml"))


@pytest.fixture
def two_kinds(folder):
    """An arm that needs an argument, and a package that lies elsewhere."""
    arm = folder / "some_robot" / "urdf" / "arm.urdf.xacro"
    text = arm.read_text().replace("2 * 1.5", "load_yaml(file).m")
    file = '<xacro:property name="file" value="$(find masses)/$(arg kind).yaml"/>'
    arm.write_text(text.replace("<xacro:property", f"{file}<xacro:property", 1))
    masses = folder / "elsewhere" / "masses_of_arms"
    masses.mkdir(parents=True)
    (masses / "package.xml").write_text("<package><name>masses</name></package>")
    (masses / "heavy.yaml").write_text("m: 5")
    return arm


def test_arguments_and_folders_are_kept_in_the_scenario_that_is_written(
    folder, two_kinds, funnel_hil, monkeypatch
):
    monkeypatch.chdir(folder)
    include = ["--include", folder / "elsewhere"]
    output = funnel_hil.output("robot", two_kinds, *include, code=2)
    assert "kind:=… gives it" in output
    written = ["--scenario", "--out", "a.yaml"]
    funnel_hil.output("robot", two_kinds, "kind:=heavy", *include, *written)
    setup = load_setup("a.yaml", ["duration_s=0.05"])
    assert setup.governing_inertia_kg_m2[0] == pytest.approx(5 * 0.2**2 + 0.04 + 0.008 * 5)
    funnel_hil.output("simulate", "a.yaml", "--set", "duration_s=0.05", "--out", "run")
    copy = load_setup("run/scenario.yaml")  # with the arm as it was read
    assert copy.robot.reading == {}
    assert copy.governing_inertia_kg_m2[0] == setup.governing_inertia_kg_m2[0]


def test_arguments_follow_an_arm_wherever_one_is_given(folder, two_kinds, funnel_hil, monkeypatch):
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(folder))
    two_kinds.write_text(two_kinds.read_text().replace('effort="5"', 'effort="50"'))
    options = ["--duration", "0.1", "--limit", "4", "--resolution", "4", "--workers", "1"]
    funnel_hil.output("margin", two_kinds, "kind:=heavy", *options, "--out", folder / "m")
    assert Scenario(f"{two_kinds} kind:=heavy").joint_names == ("hinge",)
    funnel_hil.output("robot", PAPER_ARM.path, "kind:=heavy", code=2)
    text = SCENARIO.replace("urdf: some", "xacro: {kind: heavy}, urdf: some")
    (folder / "test.yaml").write_text(text)
    assert load_setup(str(folder / "test.yaml")).robot.reading["xacro"] == {"kind": "heavy"}
    with pytest.raises(ScenarioError, match=r"kind:=heavy: only a \.xacro file has arguments"):
        load_setup(str(folder / "test.yaml"), ["robot.urdf=paper_arm"])


def test_robot_shows_gains_only_when_asked(funnel_hil):
    assert "Gains of" not in funnel_hil.output("robot", "panda")


@pytest.mark.parametrize(
    ("speeds", "said", "listed"),
    [
        ((4.8, 4.8, 4.8), "0.0417 s", "0.0417, 0.0417, 0.0417"),
        ((1.0, 10.0, 4.0), "0.02 to 0.06 s", "0.06, 0.02, 0.05"),
    ],
)
def test_estimated_friction_is_the_same_in_words_and_table(
    tmp_path, funnel_hil, speeds, said, listed
):
    """20 % of the largest torque at top speed, but at most 0.06 s of it."""
    arm, left = tmp_path / "arm.urdf", iter(speeds)
    text = (ROBOTS / "paper_arm.urdf").read_text()
    arm.write_text(re.sub(r'velocity="[^"]*"', lambda _: f'velocity="{next(left)}"', text))
    output = " ".join(funnel_hil.output("robot", arm).split())
    assert f"viscous friction ESTIMATED as {said} of the largest torque" in output
    assert f"viscous_share_s {listed}" in output


def test_robot_shows_the_inertia_and_gains_of_a_run(funnel_hil, tmp_path):
    arm = tmp_path / "arm.urdf"  # a file whose rotors are estimated
    arm.write_text((ROBOTS / "ur10e.urdf").read_text())
    shown = dict(
        re.split(r" {2,}", line.strip(), maxsplit=1)
        for line in funnel_hil.output("robot", arm, "--gains").splitlines()
        if re.search(r"\S {2,}[\d.]+, ", line)
    )
    setup = load_setup(str(arm))
    for name, used in {
        "governing, for gains": setup.governing_inertia_kg_m2, "k_1": setup.gains.k_1
    }.items():  # fmt: skip
        printed = [float(number) for number in shown[name].split(", ")]
        assert printed == pytest.approx(used.tolist(), rel=0.01)


def test_robot_shows_joints_gains_funnel_and_what_is_held(funnel_hil, tmp_path):
    picture = tmp_path / "arm.png"
    output = funnel_hil.output(
        "robot", "panda", "--gains", *(["--picture", picture] if "bullet" in INSTALLED else [])
    )
    for text in ("7 driven joints", "7 panda_joint7", "governing, for gains", "M_ii, others held",
                 "12 N m", "panda_finger_joint1", "held",
                 "finger", "Gains of fixed_time_adaptive", "k_1", "closes to 0.01"):  # fmt: skip
        assert text in output
    assert "bullet" not in INSTALLED or picture.read_bytes().startswith(b"\x89PNG")


@needs_pybullet_data
@pytest.mark.parametrize(
    ("name", "texts"),
    [
        ("xarm/xarm6_with_gripper.urdf",
         ("drive_joint", "others mimic it", "triangle rule by 0.74 %")),
        ("cartpole.urdf", ("slides", "UNLIMITED")),
    ],
)  # fmt: skip
def test_robot_shows_grippers_slides_and_warnings(funnel_hil, name, texts):
    output = funnel_hil.output("robot", f"pybullet_data:{name}")
    assert [text for text in texts if text not in output] == []


def test_one_chain_of_a_robot_is_driven_and_written(folder, funnel_hil, monkeypatch):
    monkeypatch.chdir(folder)
    (folder / "robot.urdf").write_text(TWO_ARMS)
    funnel_hil.output("robot", "robot.urdf", "--chain", "left")
    output = funnel_hil.output("robot", "robot.urdf")
    assert "Chains: --chain TIP drives one and holds the rest" in output
    written = ["--chain", "right_two_link", "--scenario", "--out", "right.yaml"]
    funnel_hil.output("robot", "robot.urdf", *written)
    assert load_setup("right.yaml").robot.joint_names == ("right_one", "right_two")
    output = funnel_hil.output("robot", "robot.urdf", "--chain", "foot", code=2)
    assert "--chain foot: must be a link" in output


@needs_bullet
def test_a_mesh_that_crashes_bullet_costs_the_picture_alone(tmp_path, funnel_hil):
    mesh = "a.dae"
    (tmp_path / mesh).write_text("<COLLADA/>")
    shape = f'<visual><geometry><mesh filename="{mesh}"/></geometry></visual>'
    arm = XACRO.replace("{effort}", "5")
    links = LINKS.partition("<xacro:macro")[2].rpartition("</robot>")[0]
    arm = arm.replace(
        '<xacro:include filename="$(find some_robot)/links.xacro"/>', f"<xacro:macro{links}"
    ).replace('<link name="base"/>', f'<link name="base">{shape}</link>')
    (tmp_path / "arm.xacro").write_text(arm)
    output = funnel_hil.output(
        "robot", tmp_path / "arm.xacro", "--picture", tmp_path / "a.png", code=2
    )
    assert (
        "Bullet cannot draw the arm: a mesh file is damaged or too large (killed by SIG" in output
    )
    (tmp_path / "test.yaml").write_text(SCENARIO.replace("some_robot/urdf/arm.urdf", "arm"))
    output = funnel_hil.output("simulate", tmp_path / "test.yaml", "--out", tmp_path / "run")
    assert "warning: the report has no pictures of the arm: Bullet cannot draw" in output
    assert (tmp_path / "run" / "report.html").exists()

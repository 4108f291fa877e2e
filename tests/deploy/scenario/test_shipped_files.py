"""A shipped arm or scenario is one file each, and one's own needs no line of code either."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from bus_schema.errors import RobotDescriptionError
from bus_schema.robot_description import load_robot
from deploy.run.simulate import simulate
from deploy.scenario import referenced_files, scenario
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError
from tests.arms import PYBULLET_DATA, needs_pybullet_data

URDF = """<robot name="pendulum"><link name="base"/><link name="rod"><inertial>
  <origin xyz="0 0 -0.5"/><mass value="1"/>
  <inertia ixx="0.1" iyy="0.1" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="pivot" type="revolute"><parent link="base"/><child link="rod"/>
  <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="50" velocity="10"/></joint></robot>"""
SCENARIO = """
name: pendulum
duration_s: 0.05
robot: {urdf: pendulum}
reference: {kind: joint_sinusoids, centre_rad: 0, terms: [{amplitude_rad: 0.1, frequency_rad_s: 1}]}
"""


@pytest.fixture
def shipped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in place of those of the package, with the files of an arm in it."""
    folder = tmp_path / "scenarios"
    folder.mkdir()
    monkeypatch.setattr(scenario, "SHIPPED", folder)
    monkeypatch.setattr(referenced_files, "ROBOTS", folder)
    (folder / "pendulum.urdf").write_text(URDF)
    (folder / "pendulum.yaml").write_text(SCENARIO)
    return folder


def test_files_among_the_shipped_ones_are_found_by_their_names(shipped: Path) -> None:
    setup = load_setup("pendulum")
    assert setup.robot.path == shipped / "pendulum.urdf"
    assert simulate(setup).data().faults() == []
    with pytest.raises(ScenarioError, match=r"one of the shipped scenarios pendulum;"):
        load_setup("pendulums")
    with pytest.raises(RobotDescriptionError, match=r"shipped robot \(pendulum\)"):
        referenced_files.find_urdf("pendulums", shipped)


def test_user_files_are_found_by_path_from_any_folder(tmp_path, monkeypatch):
    own, elsewhere = tmp_path / "own", tmp_path / "elsewhere"
    (own / "arms").mkdir(parents=True)
    elsewhere.mkdir()
    (own / "arms" / "p.urdf").write_text(URDF)
    (own / "base.yaml").write_text(SCENARIO.replace("urdf: pendulum", "urdf: arms/p.urdf"))
    (own / "heavy.yaml").write_text("extends: base.yaml\nname: heavy\nplant: {payload_kg: 1}\n")
    monkeypatch.chdir(elsewhere)
    setup = load_setup("../own/heavy.yaml")  # which extends what lies beside it
    assert setup.scenario.plant.payload_kg == 1.0
    assert setup.robot.joint_names == ("pivot",)
    assert load_setup(str(own / "base.yaml")).scenario.name == "pendulum"


@needs_pybullet_data
@pytest.mark.parametrize(
    ("name", "original"),
    [("iiwa", "kuka_iiwa/model.urdf"), ("panda_pybullet", "franka_panda/panda.urdf")],
)
def test_shipped_arm_is_the_one_of_pybullet_data_with_its_meshes(name: str, original: str) -> None:
    shipped = load_robot(referenced_files.find_urdf(name, Path()))
    theirs = load_robot(PYBULLET_DATA / original)
    assert shipped.warnings == theirs.warnings
    assert not [text for text in shipped.warnings if "mesh" in text]
    for shapes in ("named", "drawable"):
        meshes = shipped.resolved_urdf(shapes=shapes)
        assert len(ET.fromstring(meshes).findall(".//mesh")) > 10
        assert meshes == theirs.resolved_urdf(shapes=shapes)


def test_without_pybullet_data_shipped_arms_are_no_odder_and_its_own_say_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    for name in ("iiwa", "panda"):
        robot = load_robot(referenced_files.find_urdf(name, Path()))
        assert not [text for text in robot.warnings if "mesh" in text]
        assert "<mesh" not in robot.resolved_urdf(shapes="drawable")
    with pytest.raises(RobotDescriptionError, match=r"pip install 'funnel-hil\[bullet\]'"):
        referenced_files.find_urdf("pybullet_data:cartpole.urdf", Path())


@pytest.mark.parametrize(
    ("given", "meant"),
    [("d/zebra.yaml", None), ("d/nope.urdf", None), ("d/anyting.yaml", None),
     ("d/anyting.urdf", "d/anything.xml"), ("d/anyting", "d/anything.xml"),
     ("d/miin.yml", "d/mine.yaml"), ("panda.urdf", "panda"),
     ("d/linefed.urdf", r"d/line\nfeed.urdf")],
)  # fmt: skip
def test_similar_names_of_the_same_kind_are_suggested(tmp_path, monkeypatch, given, meant):
    (tmp_path / "d").mkdir()
    for name in ("anything.xml", "ok.urdf", "mine.yaml", "line\nfeed.urdf"):
        (tmp_path / "d" / name).touch()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ScenarioError) as refused:
        load_setup(given)
    assert str(refused.value).partition("; did you mean ")[2] == (f"{meant}?" if meant else "")


@pytest.mark.parametrize(
    ("given", "setting", "begins"),
    [("c\nd", [], r"c\nd: is a folder: must be a file, such as e\nf.yaml, g\nh.yaml in it"),
     ("c\nd/e\nf.yaml", [], r"HERE/c\nd/e\nf.yaml: must be a mapping"),
     ("c\nd/g\nh.yaml", [], r"HERE/c\nd/g\nh.yaml: law: unknown key"),
     ("a\nb.yaml", [], r"a\nb.yaml: no such file"),
     ("paper_arm", ["robot.initial_offset_rad=[a,\n1]"],
      r"--set robot.initial_offset_rad=[a,\n1]: robot.initial_offset_rad"),
     ("paper_arm", ["a\nb=1"], r"--set a\nb=1: a\nb: unknown key")],
)  # fmt: skip
def test_line_feeds_in_names_and_values_begin_no_line(
    tmp_path, monkeypatch, given, setting, begins
):
    (tmp_path / "c\nd").mkdir()
    (tmp_path / "c\nd/e\nf.yaml").write_text("- 1\n")
    (tmp_path / "c\nd/g\nh.yaml").write_text("extends: paper_arm\nlaw: 1\n")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ScenarioError) as refused:
        load_setup(given, setting)
    assert "\n" not in str(refused.value)
    assert str(refused.value).startswith(begins.replace("HERE", str(tmp_path)))

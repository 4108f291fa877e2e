"""A shipped arm or scenario is one file each, and one's own needs no line of code either."""

from __future__ import annotations

from pathlib import Path

import pytest

from bus_schema.errors import RobotDescriptionError
from deploy.runs.simulate import simulate
from deploy.scenario import referenced_files, scenario
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError

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


def test_files_of_ones_own_are_found_by_their_path_from_anywhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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

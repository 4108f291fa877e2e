"""A scenario in a folder of results gives the same run again, also when its sources change."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from bus_schema.recording.atomic_files import write_whole
from deploy.run.run_folder import RunFolder, read_summary
from deploy.run.simulate import simulate
from deploy.scenario.effective import write_scenario
from deploy.scenario.referenced_files import find_urdf
from deploy.scenario.scenario import load_setup
from tests.arms import needs_pybullet_data

ARM = find_urdf("paper_arm", Path()).read_text()


@pytest.fixture
def own_arm(tmp_path):
    """A scenario of its own arm, whose gains are derived."""
    (tmp_path / "own.urdf").write_text(ARM)
    (tmp_path / "own.txt").write_text("1\n2\n")
    file = tmp_path / "own.yaml"
    file.write_text(yaml.safe_dump({
        "extends": "paper_arm", "duration_s": 0.05, "robot": {"urdf": "own.urdf"},
        "controller": {"law": "smc"},
        "link": {"uplink": {"distribution": "empirical", "distribution_file": "own.txt"}},
    }))  # fmt: skip
    return file


def test_an_edited_arm_changes_no_run_that_is_done_again(own_arm, tmp_path, funnel_hil):
    first, second = tmp_path / "first", tmp_path / "second"
    assert funnel_hil("simulate", str(own_arm), "--out", str(first))[0] == 0
    write_whole(tmp_path / "own.urdf", ARM.replace('mass value="', 'mass value="1'))
    (tmp_path / "own.txt").unlink()
    assert funnel_hil("simulate", str(first / "scenario.yaml"), "--out", str(second))[0] == 0
    assert read_summary(first)["digest"] == read_summary(second)["digest"]


def test_a_folder_can_be_moved_with_its_arm(own_arm, tmp_path):
    folder = RunFolder.begin(load_setup(str(own_arm)), tmp_path / "here")
    moved = folder.path.rename(tmp_path / "there")
    (tmp_path / "own.urdf").unlink()
    again = load_setup(str(moved / "scenario.yaml"))
    assert again.robot.path.parent == moved
    assert again.robot.text == ARM


def test_gains_and_limits_that_follow_from_the_arm_are_written_out(tmp_path):
    setup = load_setup("iiwa", ["controller.law=pid", "duration_s=0.05"])
    folder = RunFolder.begin(setup, tmp_path / "run")
    written = yaml.safe_load(folder.scenario.read_text())
    gains, limits = written["controller"]["gains"]["pid"], written["limits"]
    assert gains["proportional"] == setup.gains.proportional.tolist()
    assert limits["torque_nm"] == setup.robot.effort_limits_nm.tolist()
    assert limits["velocity_rad_s"] == setup.robot.velocity_limits_rad_s.tolist()
    again = load_setup(str(folder.scenario))
    assert simulate(again).data().digest == simulate(setup).data().digest


def test_a_scenario_that_is_written_again_keeps_the_names_of_its_files(own_arm, tmp_path):
    first = RunFolder.begin(load_setup(str(own_arm)), tmp_path / "first")
    second = RunFolder.begin(load_setup(str(first.scenario)), tmp_path / "second")
    assert second.scenario.read_text() == first.scenario.read_text()
    assert {f.name for f in second.path.iterdir()} == {f.name for f in first.path.iterdir()}


def test_default_of_metrics_from_s_follows_the_duration(tmp_path, funnel_hil):
    first, second = tmp_path / "first", tmp_path / "second"
    short = ("--set", "duration_s=0.4")
    assert funnel_hil("simulate", *short, "--no-report", "--out", str(first))[0] == 0
    again = ("simulate", str(first / "scenario.yaml"), "--no-report", "--out", str(second))
    assert funnel_hil(*again)[0] == 0
    assert read_summary(first)["tracking"] == read_summary(second)["tracking"]
    funnel_hil.output(*again, "--overwrite", "--set", "duration_s=0.2")
    assert load_setup(str(second / "scenario.yaml")).scenario.metrics.from_s == 0.1
    assert funnel_hil("report", str(first))[0] == 0
    assert read_summary(first)["tracking"]["rms_rad"] != read_summary(second)["tracking"]["rms_rad"]


@needs_pybullet_data
def test_arm_of_mujocos_is_written_as_the_urdf_it_became(tmp_path):
    file = tmp_path / "reacher.yaml"
    file.write_text(
        "{name: reacher, duration_s: 0.1, metrics: {from_s: 0.05},"
        " robot: {urdf: 'pybullet_data:mjcf/reacher.xml'}, reference: {kind: minimum_jerk,"
        " waypoints: [{time_s: 0, position_rad: [0, 0]}]}}"
    )
    setup = load_setup(str(file))
    (tmp_path / "run").mkdir()
    write_scenario(setup, tmp_path / "run" / "scenario.yaml")
    again = load_setup(str(tmp_path / "run" / "scenario.yaml"))
    assert again.robot.path.suffix == ".urdf"
    assert again.robot.joint_names == setup.robot.joint_names == ("joint0", "joint1")
    assert again.robot.text == setup.robot.text

"""A run of a mounted arm is recorded, read again and replayed with one mount."""

import numpy as np
import pytest

from controller.manipulator_model import ManipulatorModel
from deploy.run.run_folder import load_run
from deploy.scenario.scenario import load_setup


@pytest.mark.parametrize("only_the_recording", [False, True])
def test_mount_is_applied_once_to_a_recorded_run(tmp_path, funnel_hil, only_the_recording):
    """The recording holds the mounted arm, and a scenario that mounts it."""
    mount = "robot.base_rpy_rad=[1.5,0.2,0]"
    expected = ManipulatorModel(load_setup("paper_arm", [mount]).robot).gravity(np.zeros(3))
    words = ("--set", "duration_s=0.1", "--set", mount, "--out", tmp_path / "run")
    funnel_hil.output("simulate", "paper_arm", *words)
    place = tmp_path / "run"
    setup = load_run(place / "run.mcap" if only_the_recording else place)[0].setup
    links = ManipulatorModel(setup.robot).gravity(np.zeros(3))
    np.testing.assert_allclose(links, expected)
    assert setup.robot.resolved_urdf().count('link name="funnel_hil_mount"') == 1
    funnel_hil.output("replay", place)

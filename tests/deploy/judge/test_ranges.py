"""Joints that pass the ends of their ranges in a run are named with how far, and when."""

import numpy as np
import pytest

from bus_schema.messages import topics
from deploy.judge.metrics import summarise
from deploy.reports.verdict_texts import verdict_on_run
from deploy.run.execute import execute
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from tests.deploy.scenario.test_starter import ARM

PUSHED = "plant.disturbance.terms=[{joint: joint1, kind: constant, torque_nm: -60}]"
"""Opposes actuators of 20 N m, so it drives the second joint upwards."""


@pytest.fixture
def setup(tmp_path):
    (tmp_path / "two.urdf").write_text(ARM.format(60, 20))

    def of(*words):
        return load_setup(str(tmp_path / "two.urdf"), ["duration_s=1.5", *words])

    return of


def test_joint_that_is_pushed_beyond_its_range_is_named_in_terminal_and_summary(setup):
    judged = execute(setup(PUSHED))
    truth = judged.data.tables[topics.PLANT_TRUTH.name]["position"]
    upper = judged.data.setup.robot.upper_rad[1]
    most = truth[:, 1].max() - upper
    assert most > 3.0
    (found,) = [each for each in judged.summary["beyond_ranges"] if each["joint"] == "joint1"]
    assert found["beyond_rad"] == pytest.approx(most)
    assert found["time_s"] == pytest.approx(0.001 * np.argmax(truth[:, 1]))
    (warning,) = [each for each in verdict_on_run(judged).reasons if "ranges" in each]
    assert f"joint1 by {most:.3g} rad" in warning


def test_arm_inside_its_ranges_and_endless_joints_have_no_such_sentence(setup):
    judged = execute(setup())
    assert judged.summary["beyond_ranges"] == []
    assert not [each for each in verdict_on_run(judged).reasons if "ranges" in each]
    endless = load_setup("iiwa", ["duration_s=0.2", "metrics.from_s=0.1"])
    assert summarise(simulate(endless).data())["beyond_ranges"] == []

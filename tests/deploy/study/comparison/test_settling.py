from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from deploy.scenario.scenario import load_setup
from deploy.studies.comparison.comparison import LawComparison
from deploy.studies.comparison.sentences import settling_sentence
from deploy.study.comparison.settling import SETTLING, SettlingTest, Start, offset_of, settling_test


def test_every_start_is_off_by_its_size_on_the_scenarios_side():
    setup = load_setup("paper_arm")
    for size in (0.01, 0.2):
        # paper_arm's own offset is to these sides
        np.testing.assert_allclose(offset_of(setup, size), size * np.array([1.0, -1.0, 1.0]))


def test_a_start_goes_no_farther_than_the_joints_range_on_its_roomier_side():
    setup = load_setup("panda", ["funnel.widest_rad=4"])
    offset = offset_of(setup, 3.0)
    target = setup.start_position_rad - setup.scenario.robot.initial_offset_rad
    robot = setup.robot
    assert (target + offset >= robot.lower_rad).all()
    assert (target + offset <= robot.upper_rad).all()
    roomier = np.maximum(robot.upper_rad - target, target - robot.lower_rad)
    np.testing.assert_allclose(np.abs(offset), np.minimum(roomier, 3.0))


def test_starts_that_a_range_makes_equal_run_once():
    """The joints of a panda turn by less than 3 rad to each side of the reference."""
    sizes = {"settling_rad": [0.01, 20.0, 30.0]}
    comparison = LawComparison({"scenario": "panda", "laws": ["pid"], **sizes}, Path("compare"))
    starts = [run.columns["offset_rad"] for run in comparison.first()]
    assert starts == [None, 0.01, 20.0]


def test_starts_settle_when_their_last_joint_does():
    row = {"settling_time_s": [0.3, 0.5], "settling_bound_s": [2.0, 2.0], "completed": True,
           "verdict": "kept"}  # fmt: skip
    faulted = {"settling_time_s": None, "settling_bound_s": None, "completed": False,
               "verdict": "faulted"}  # fmt: skip
    test = settling_test("law", [([0.1, -0.1], row), ([0.2, 0.2], faulted)])
    assert test.bound_s == 2.0
    assert [start.settling_time_s for start in test.starts] == [0.5, None]
    assert [start.bounds_kept for start in test.starts] == [True, False]
    assert not test.holds


def test_a_bound_holds_only_if_every_start_settled_within_it():
    def with_times(*times):
        rows = [Start([1.0], time, bounds_kept=True) for time in times]
        return SettlingTest("law", 2.0, rows)

    assert with_times(0.5, 2.0).holds
    assert not with_times(0.5, 2.1).holds
    assert not with_times(0.5, None).holds


def test_results_survive_json():
    rows = [Start([0.1, -0.1], None, bounds_kept=False)]
    test = SettlingTest("smc", None, rows)
    (again,) = SETTLING.validate_python(json.loads(json.dumps(SETTLING.dump_python([test]))))
    assert again == test
    assert settling_sentence(again) == "smc: settled from 0 of 1 starts of up to 0.1 rad"

from __future__ import annotations

import json

import numpy as np
import pytest

from deploy.cli.study.experiments import settling_sentence
from deploy.scenario.scenario import load_setup
from deploy.study.comparison.comparison import SETTLING
from deploy.study.comparison.settling import SettlingTest, Start, settling_test


def test_every_start_is_off_by_its_size_on_the_scenarios_side():
    result = settling_test(load_setup("paper_arm", ["duration_s=0.05"]), (0.01, 0.2))
    signs = np.array([1.0, -1.0, 1.0])  # those of paper_arm's own offset
    for row, size in zip(result.starts, (0.01, 0.2), strict=True):
        np.testing.assert_allclose(row.offset_rad, size * signs)
        assert row.distance_rad == pytest.approx(size)


def test_a_start_goes_no_farther_than_the_joints_range_on_its_roomier_side():
    setup = load_setup("panda", ["duration_s=0.05", "funnel.widest_rad=4"])
    (row,) = settling_test(setup, (3.0,)).starts
    target = setup.start_position_rad - setup.scenario.robot.initial_offset_rad
    start = target + row.offset_rad
    robot = setup.robot
    assert (start >= robot.lower_rad).all()
    assert (start <= robot.upper_rad).all()
    roomier = np.maximum(robot.upper_rad - target, target - robot.lower_rad)
    np.testing.assert_allclose(np.abs(row.offset_rad), np.minimum(roomier, 3.0))


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

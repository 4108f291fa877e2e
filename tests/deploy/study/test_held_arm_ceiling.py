"""How long an arm may be held at its start before its error leaves the funnel."""

from __future__ import annotations

import json

import pytest

from deploy.scenario.scenario import load_setup
from deploy.study.quantities import held_arm_ceiling_ms


def held(name, offset_scale=1.0, *overrides):
    offset = (offset_scale * load_setup(name).scenario.robot.initial_offset_rad).tolist()
    start = f"robot.initial_offset_rad={json.dumps(offset)}"
    return load_setup(name, [start, *overrides])


@pytest.mark.parametrize(
    ("name", "scale", "ceiling_ms"),
    [("paper_arm", 1.0, 123), ("paper_arm", 0.0, 175), ("iiwa", 1.0, 66), ("iiwa", 0.0, 41),
     ("panda", 1.0, 228)],
)  # fmt: skip
def test_the_ceilings_of_the_shipped_arms(name, scale, ceiling_ms):
    # Found independently, with another simulation of the same scenarios.
    assert held_arm_ceiling_ms(held(name, scale)) == pytest.approx(ceiling_ms, abs=0.5)


def test_a_slower_reference_leaves_more_time_and_one_at_rest_all_of_it():
    assert held_arm_ceiling_ms(held("iiwa", 0.0, "reference.speed=0.5")) > 60
    assert held_arm_ceiling_ms(held("iiwa", 0.0, "reference.speed=1e-6")) is None


def test_an_arm_that_is_as_wide_off_as_its_funnel_at_rest_leaves_when_it_closes():
    # A start of 0.1 rad: the bound (1.2 · 0.1 + 0.05 − 0.01) e^(−4 t) + 0.01 is 0.1 after
    # ln(0.16 / 0.09) / 4 = 143.8 ms, while nothing moves.
    jerk = '{"kind": "minimum_jerk", "waypoints": [{"time_s": 0, "position_rad": 0.5}]}'
    setup = load_setup("paper_arm", [f"reference={jerk}", "robot.initial_offset_rad=0.1"])
    assert held_arm_ceiling_ms(setup) == pytest.approx(143.8, abs=0.11)


def test_what_the_other_direction_has_counts_against_one():
    setup = load_setup("paper_arm", ["link.downlink.delay_ms=20"])
    assert held_arm_ceiling_ms(setup, "both") == pytest.approx(122.7)
    assert held_arm_ceiling_ms(setup, "uplink") == pytest.approx(102.7)
    assert held_arm_ceiling_ms(setup, "downlink") == pytest.approx(122.7)

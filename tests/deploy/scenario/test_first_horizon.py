"""The horizon at the start of a run, on links whose delay changes."""

from __future__ import annotations

import pytest

from deploy.scenario.held_arm import held_arm_ceiling_ms
from deploy.scenario.scenario import load_setup

ON = "controller.delay_compensation.enabled=true"
SIDES = "uplink", "downlink"


def setup_of(*overrides: str):
    return load_setup("paper_arm", [ON, *overrides])


@pytest.mark.parametrize(
    ("at_first_ms", "entry", "first_ms"),
    [
        (1, "kind: ramp, at_s: 1, for_s: 2, delay_ms: 50", 2.0),  # 100 ms, of which 150 grow
        (1, "kind: step, at_s: 1, delay_ms: 50", 50.0),  # 100 ms, of which 50 grow until 1 s
        (10, "kind: step, at_s: 3, delay_ms: 40", 20.0),  # later than it takes to grow
        (30, "kind: step, at_s: 1, delay_ms: 5", 60.0),  # shorter later
        (30, "kind: outage, at_s: 1, for_s: 1", 60.0),
    ],
)
def test_a_horizon_begins_as_short_as_lets_it_grow_ahead_of_the_schedule(
    at_first_ms, entry, first_ms
):
    """It grows by 5 % of the time."""
    channels = [
        f"link.{side}={{delay_ms: {at_first_ms}, schedule: [{{{entry}}}]}}" for side in SIDES
    ]
    setup = setup_of(*channels)
    assert setup.horizon.first_ns == pytest.approx(1e6 * first_ms, abs=1)
    assert setup.is_levelled


def test_changes_of_one_direction_count_beside_the_delay_of_the_other():
    """60 ms up from 1 s on, and down 40 ms until 2 s: 100 − 50 at 1 s."""
    up = "link.uplink={delay_ms: 1, schedule: [{kind: step, at_s: 1, delay_ms: 60}]}"
    down = "link.downlink={delay_ms: 40, schedule: [{kind: step, at_s: 2, delay_ms: 1}]}"
    assert setup_of(up, down).horizon.first_ns == pytest.approx(50e6, abs=1)


def test_delays_of_a_network_are_waited_for_as_long_as_the_arm_can_be_held_easily():
    """15 % of the longest time at first, 40 % later, although some delays are longer."""
    traces = [f"link.{side}.trace={{file: wifi_campus, start_s: 0}}" for side in SIDES]
    setup = setup_of(*traces)
    held_ms = held_arm_ceiling_ms(setup)
    assert setup.horizon.first_ns == pytest.approx(0.15e6 * held_ms, abs=1)
    assert setup.horizon.wanted_ns == pytest.approx(0.4e6 * held_ms, abs=1)
    assert setup.horizon.most_ns == setup.horizon.wanted_ns
    assert not setup.is_levelled

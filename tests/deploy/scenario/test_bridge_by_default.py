"""Where commands hold rows for the time after they act, by default, and for how long."""

from __future__ import annotations

import pytest

from controller.compensation.command_timeline import PIECES
from deploy.scenario.scenario import load_setup

ON = "controller.delay_compensation.enabled=true"
EXPECTED = "controller.delay_compensation.expected_round_trip_ms=40"
CUT = "faults=[{kind: link_cut, direction: downlink, at_s: 1, for_s: 0.1}]"
BURSTS = "link.uplink.burst_loss={mean_loss: 0.01, mean_burst: 5}"
TCP = "link.transport=tcp"


def bridge_ms(*overrides: str) -> float:
    setup = load_setup("paper_arm", [ON, *overrides])
    return 1e-6 * setup.horizon.row_ticks * PIECES * setup.grid.period_ns


@pytest.mark.parametrize(
    "overrides",
    [
        ("link.uplink.trace={file: wifi_campus, start_s: 0}",),
        ("link.uplink.schedule=[{kind: outage, at_s: 1, for_s: 0.1}]",),
        (BURSTS,),
        (CUT,),
        (TCP, "link.downlink.loss=0.02"),  # what is lost comes later, and all behind it
        (EXPECTED,),  # a real link: nothing is emulated
    ],
)
def test_commands_that_may_come_too_late_bridge_200_ms(overrides):
    assert bridge_ms(*overrides) == pytest.approx(200.0)


@pytest.mark.parametrize(
    "overrides",
    [
        (),
        ("link.uplink.delay_ms=20", "link.downlink.delay_ms=20"),
        ("link.uplink.delay_ms=20", "link.downlink.delay_ms=20", EXPECTED),
        ("link.downlink.loss=0.02",),  # single ones
        (CUT, "controller.delay_compensation.predictor=smith"),  # knows no torque of the arm
    ],
)
def test_no_bridge_where_each_command_comes_in_time(overrides):
    assert bridge_ms(*overrides) == 0.0


@pytest.mark.parametrize(
    ("rate_hz", "timeout_ms", "expected_ms"), [(50, 200, 160), (100, 50, 40), (2000, 200, 200)]
)
def test_a_bridge_is_not_longer_than_the_time_out(rate_hz, timeout_ms, expected_ms):
    """Four pieces of whole ticks: at 50 Hz, 80 ms or 160 ms."""
    found = bridge_ms(CUT, f"rate_hz={rate_hz}", f"plant.command_timeout_ms={timeout_ms}")
    assert found == pytest.approx(expected_ms)


def test_the_limit_of_the_play_out_contains_the_actuators_dead_time():
    horizon = load_setup("panda_motors", [ON, "plant.actuator.delay_ms=20"]).horizon
    plain = load_setup("panda_motors", [ON]).horizon
    assert horizon.most_ns - plain.most_ns == 20_000_000

"""What `run --real-delay` refuses, and how it changes a scenario."""

from __future__ import annotations

import pytest

from deploy.run.network.real_delay import RealDelay, knowing_real_delay, real_delay
from deploy.scenario.scenario import load_setup


def test_deadline_allows_for_the_real_delay_beside_the_emulated_one() -> None:
    setup = load_setup("paper_arm", ["link.uplink.delay_ms=3", "link.downlink.delay_ms=2"])
    assert knowing_real_delay(setup, 8.0).scenario.link.deadline_ms == pytest.approx(14.0)


def test_deadline_of_the_scenario_stays() -> None:
    setup = load_setup("paper_arm", ["link.deadline_ms=7"])
    assert knowing_real_delay(setup, 8.0).scenario.link.deadline_ms == 7.0


def test_controller_alone_is_sent_to_the_relay() -> None:
    setup = load_setup("paper_arm", ["link.security.enabled=true"])
    delay = real_delay(setup, 8.0)
    assert delay.plant_endpoint == "tls/127.0.0.1:7451"
    assert delay.endpoint.startswith("tls/127.0.0.1:")
    assert delay.endpoint != delay.plant_endpoint


def test_relay_and_controller_are_given_each_others_place() -> None:
    delay = RealDelay(9.0, "tcp/127.0.0.1:7453", "tcp/127.0.0.1:7451")
    assert delay.options[:2] == ("127.0.0.1:7453", "127.0.0.1:7451")
    assert delay.options.link.uplink == delay.options.link.downlink
    assert delay.options.link.uplink.delay_ms == 4.5
    assert delay.override == "link.plant_endpoint=tcp/127.0.0.1:7453"

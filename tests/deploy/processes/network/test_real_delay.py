"""What `run --real-delay` refuses, and how it changes a scenario."""

from __future__ import annotations

import pytest

from deploy.processes.network.real_delay import (
    RealDelay,
    check_real_delay,
    knowing_real_delay,
    real_delay,
)
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError


@pytest.mark.parametrize("round_trip_ms", [-1.0, 1000.1, float("nan"), float("inf")])
def test_round_trip_out_of_range_is_refused(round_trip_ms: float) -> None:
    with pytest.raises(ScenarioError, match=r"--real-delay .*: must be a round trip of 0 to 1000"):
        check_real_delay(load_setup("paper_arm"), round_trip_ms)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("clock=lockstep", r"clock = 'lockstep': must be realtime"),
        ("link.kind=in_process", r"link.kind = 'in_process': must be zenoh"),
        ("link.plant_endpoint=udp/127.0.0.1:7451", r"link.plant_endpoint = .*: must be tcp/ or"),
        ("link.router_endpoint=tcp/127.0.0.1:7447", r"link.router_endpoint = .*: must be left out"),
    ],
)
def test_scenario_without_such_a_link_is_refused(override: str, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        check_real_delay(load_setup("paper_arm", [override]), 5.0)


def test_can_is_refused() -> None:
    with pytest.raises(ScenarioError, match=r"link.kind = 'can': must be zenoh"):
        check_real_delay(load_setup("paper_arm_can"), 5.0)


def test_refusal_comes_before_anything_starts(funnel_hil, nothing_starts) -> None:
    code, said = funnel_hil("run", "paper_arm", "--real-delay", "5", "--set", "clock=lockstep")
    assert code == 2
    assert "clock = 'lockstep': must be realtime" in said


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nowhere", "127.0.0.1:1", "--delay", "1"], "'nowhere': must be HOST:PORT"),
        (["127.0.0.1:1", "127.0.0.1:99999", "--delay", "1"], "must be HOST:PORT"),
        (["127.0.0.1:1", "127.0.0.1:2", "--delay", "-1"], "--delay -1: must be 0 to 1000 ms"),
    ],
)
def test_relay_refuses_bad_input(funnel_hil, words: list[str], message: str) -> None:
    code, said = funnel_hil("relay", *words)
    assert code == 2
    assert message in said


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


def test_words_of_relay_and_controller() -> None:
    delay = RealDelay(9.0, "tcp/127.0.0.1:7453", "tcp/127.0.0.1:7451")
    assert delay.arguments == ["relay", "127.0.0.1:7453", "127.0.0.1:7451", "--delay", "4.5"]
    assert delay.override == ["--set", "link.plant_endpoint=tcp/127.0.0.1:7453"]

from __future__ import annotations

import pytest

from bus_schema.link.configuration import LinkConfiguration
from deploy.judge.link_words import has_no_delay, link_words
from deploy.scenario.scenario import load_setup


@pytest.mark.parametrize(
    ("uplink", "downlink", "words"),
    [
        ({}, {}, "no link delay"),
        ({"delay_ms": 3}, {"delay_ms": 1.5}, "round trip 4.5 ms"),
        ({}, {"loss": 0.1}, "losses"),
        ({"delay_ms": 2, "jitter_ms": 1}, {"loss": 0.1}, "round trip 2 ms, jitter, losses"),
        ({"trace": {"file": "/a/wifi.csv"}}, {"trace": {"file": "/a/wifi.csv"}}, "network wifi"),
        ({"trace": {"file": "wifi-52ea602a.parquet"}}, {}, "network wifi"),
        (
            {"trace": {"file": "uplink_trace"}},
            {"trace": {"file": "downlink_trace"}},
            "a recorded network",
        ),
        ({"duplicate": 0.2}, {}, "duplicates"),
    ],
)
def test_words_name_the_round_trip_and_what_else_happens(uplink, downlink, words):
    link = LinkConfiguration.model_validate({"uplink": uplink, "downlink": downlink})
    assert link_words(link) == words
    scenario = load_setup("paper_arm").scenario.model_copy(update={"link": link})
    assert has_no_delay(scenario) is (words == "no link delay")


def test_a_playout_delays_every_command():
    assert link_words(LinkConfiguration(playout_ms=30.0)) == "play-out 30 ms"


@pytest.mark.parametrize("setting", ["link.playout_ms=30", "plant.actuator.delay_ms=5"])
def test_what_delays_commands_beside_the_link_is_a_delay(setting):
    assert has_no_delay(load_setup("paper_arm").scenario)
    assert not has_no_delay(load_setup("paper_arm", [setting]).scenario)


@pytest.mark.parametrize(
    ("manifest", "words"),
    [
        ({"scenario": {"link": {"uplink": {"trace": {"file": "lab.csv"}}}}}, "network lab"),
        ({"scenario": {"link": {"uplink": ["not a section"]}}}, "a recorded network"),
        ({"scenario": None}, "a recorded network"),
    ],
)
def test_a_recorded_network_has_the_name_that_the_user_gave(manifest, words):
    link = LinkConfiguration.model_validate({"uplink": {"trace": {"file": "uplink_trace"}}})
    assert link_words(link, manifest) == words

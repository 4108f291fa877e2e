from __future__ import annotations

import pytest

from bus_schema.link.configuration import LinkConfiguration
from deploy.judge.link_words import has_no_effect, link_words


@pytest.mark.parametrize(
    ("uplink", "downlink", "words"),
    [
        ({}, {}, "no link delay"),
        ({"delay_ms": 3}, {"delay_ms": 1.5}, "round trip 4.5 ms"),
        ({}, {"loss": 0.1}, "losses"),
        ({"delay_ms": 2, "jitter_ms": 1}, {"loss": 0.1}, "round trip 2 ms, jitter, losses"),
        ({"trace": {"file": "/a/wifi.csv"}}, {"trace": {"file": "/a/wifi.csv"}}, "network wifi"),
    ],
)
def test_words_name_the_round_trip_and_what_else_happens(uplink, downlink, words):
    link = LinkConfiguration.model_validate({"uplink": uplink, "downlink": downlink})
    assert link_words(link) == words
    assert has_no_effect(link) is (words == "no link delay")

"""The largest delay that a direction is configured to have."""

from __future__ import annotations

import pytest

from bus_schema.link.channel_configuration import ChannelConfiguration
from plant_emulator.channel.delay_range import largest_delay_ns

MS = 1_000_000
WAVE = {"shape": "square", "period_ms": 20, "least_ms": 1}


@pytest.mark.parametrize(
    ("section", "largest_ms"),
    [
        ({}, 0),
        ({"delay_ms": 7, "loss": 0.1, "duplicate": 0.1}, 7),
        ({"delay_ms": 7, "pattern": WAVE}, 7),
        ({"delay_ms": 7, "schedule": [{"kind": "step", "at_s": 1, "delay_ms": 9}]}, 9),
        ({"delay_ms": 7, "schedule": [{"kind": "outage", "at_s": 1, "for_s": 1}]}, 7),
        ({"delay_ms": 7, "jitter_ms": 1}, None),
        ({"delay_ms": 7, "schedule": [{"kind": "step", "at_s": 1, "jitter_ms": 1}]}, None),
        ({"delay_ms": 7, "rate_kbit_s": 1000}, None),
        ({"delay_ms": 7, "schedule": [{"kind": "step", "at_s": 1, "rate_kbit_s": 1}]}, None),
    ],
)
def test_largest_delay_of_what_is_configured(section, largest_ms):
    found = largest_delay_ns(ChannelConfiguration(**section))
    assert found == (None if largest_ms is None else largest_ms * MS)


def test_largest_delay_of_a_trace_counts_one_message_of_many(tmp_path):
    file = tmp_path / "trace.csv"
    rows = [f"{at},{55.5 if at == 1234 else 2}" for at in range(5000)]
    file.write_text("\n".join(["time_s,delay_ms", *rows, ""]))
    trace = {"file": str(file), "scale": 2, "offset_ms": 1}
    assert largest_delay_ns(ChannelConfiguration(delay_ms=3, trace=trace)) == 115 * MS


def test_delays_drawn_from_a_file_have_no_known_limit(tmp_path):
    file = tmp_path / "delays.csv"
    file.write_text("delay_ms\n1\n2\n")
    drawn = {"distribution": "empirical", "distribution_file": str(file)}
    assert largest_delay_ns(ChannelConfiguration(**drawn)) is None

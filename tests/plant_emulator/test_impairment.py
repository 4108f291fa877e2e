from dataclasses import asdict

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bus_schema.link_configuration import ChannelConfiguration
from plant_emulator.impairment import NEVER_NS, Channel

SENDING_NS = st.lists(st.integers(0, 10**9), max_size=50).map(sorted)


def drain(channel):
    received = []
    while channel.next_due_ns < NEVER_NS:
        due_ns = channel.next_due_ns
        received.append(channel.receive())
        assert received[-1][0] == due_ns
    return received


@settings(deadline=None)
@given(sending_ns=SENDING_NS, delay_us=st.integers(0, 10**6))
def test_everything_comes_out_in_order_after_a_constant_delay(sending_ns, delay_us):
    channel = Channel(ChannelConfiguration(delay_ms=delay_us / 1000))
    for index, now_ns in enumerate(sending_ns):
        channel.send(index, now_ns)
    expected = [(now_ns + 1000 * delay_us, index) for index, now_ns in enumerate(sending_ns)]
    assert drain(channel) == expected
    assert asdict(channel.counts) == {
        "sent": len(sending_ns), "delivered": len(sending_ns),
        "lost": 0, "duplicated": 0, "reordered": 0,
    }  # fmt: skip


def test_what_is_on_its_way_is_not_delivered():
    channel = Channel(ChannelConfiguration(delay_ms=2.5))
    channel.send("first", 1_000)
    channel.send("second", 2_000)
    assert channel.next_due_ns == 2_501_000
    assert channel.receive() == (2_501_000, "first")
    assert (channel.counts.sent, channel.counts.delivered) == (2, 1)
    assert channel.next_due_ns == 2_502_000


def test_empty_channel_has_nothing_due():
    channel = Channel(ChannelConfiguration())
    assert channel.next_due_ns == NEVER_NS
    with pytest.raises(IndexError):
        channel.receive()


@pytest.mark.parametrize("delay_ms", [-1.0, float("nan"), float("inf")])
def test_impossible_delays_are_refused(delay_ms):
    with pytest.raises(ValueError, match="delay_ms"):
        ChannelConfiguration(delay_ms=delay_ms)

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plant_emulator.channel.channel import NEVER_NS, Channel

SENDING_NS = st.lists(st.integers(0, 10**9), max_size=50).map(sorted)


@given(sending_ns=SENDING_NS, delay_ns=st.integers(0, 10**9))
def test_everything_comes_out_in_order_after_a_constant_delay(sending_ns, delay_ns):
    channel = Channel(delay_ns)
    for index, now_ns in enumerate(sending_ns):
        channel.send(index, now_ns, size_bytes=100)
    expected = [(now_ns + delay_ns, index) for index, now_ns in enumerate(sending_ns)]
    assert channel.take_due(NEVER_NS - 1) == expected
    summary = channel.statistics().summary()
    assert (summary["sent"], summary["delivered"]) == (len(sending_ns), len(sending_ns))
    assert (summary["lost"], summary["duplicated"], summary["reordered"]) == (0, 0, 0)
    if sending_ns:
        assert set(summary["delay_ms"].values()) == {
            (delay_ns + 500) // 1000 / 1000
        }  # to the nearest µs


def test_what_is_on_its_way_is_not_delivered():
    channel = Channel(2_500_000)
    channel.send("first", 1_000, 100)
    channel.send("second", 2_000, 100)
    assert channel.next_due_ns == 2_501_000
    assert channel.take_due(2_500_999) == []
    assert channel.receive() == (2_501_000, "first")
    assert (channel.statistics().sent, channel.statistics().delivered) == (2, 1)
    assert channel.next_due_ns == 2_502_000


def test_empty_channel_has_nothing_due():
    channel = Channel(0)
    assert channel.next_due_ns == NEVER_NS
    assert channel.take_due(NEVER_NS - 1) == []
    assert set(channel.statistics().summary()["delay_ms"].values()) == {None}
    with pytest.raises(IndexError):
        channel.receive()

from hypothesis import given
from hypothesis import strategies as st

from plant_emulator.watchdog import Watchdog


def test_first_command_has_until_its_own_instant():
    watchdog = Watchdog(timeout_ns=100, first_command_ns=250)
    assert watchdog.expires_ns >= 250
    assert watchdog.expires_ns < 251


def test_each_command_buys_one_timeout():
    watchdog = Watchdog(timeout_ns=100, first_command_ns=250)
    watchdog.feed(200)
    assert watchdog.expires_ns >= 300
    assert watchdog.expires_ns < 301
    watchdog.feed(290)
    assert watchdog.expires_ns >= 390
    assert watchdog.expires_ns < 391


@given(timeout_ns=st.integers(1, 1000), gaps=st.lists(st.integers(0, 1000), min_size=1))
def test_expires_exactly_when_the_silence_is_longer_than_the_timeout(timeout_ns, gaps):
    watchdog, now_ns = Watchdog(timeout_ns, timeout_ns), 0
    for gap in gaps:
        now_ns += gap
        assert (watchdog.expires_ns < now_ns) == (gap > timeout_ns)
        watchdog.feed(now_ns)

"""What a session says of its connections."""

import time

import pytest
from zenoh_pair import free_endpoint

from bus_schema.zenoh.session import ZenohSession

HANG_S = 30.0


@pytest.mark.parametrize("low_latency", [True, False])
def test_who_is_connected_can_be_asked_in_both_modes(low_latency):
    """Asked for its transports without queues, zenoh 1.10 panics."""
    endpoint = free_endpoint()
    here = ZenohSession([endpoint], [], low_latency=low_latency)
    there = ZenohSession([], [endpoint], low_latency=low_latency)
    try:
        give_up_s = time.monotonic() + HANG_S
        while not (here.connected() and there.connected()) and time.monotonic() < give_up_s:
            time.sleep(0.01)
        assert here.connected() == {there.identifier}
        assert there.connected() == {here.identifier}
    finally:
        there.close()
        here.close()

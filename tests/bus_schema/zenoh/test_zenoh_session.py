"""What a session knows of its connections."""

from __future__ import annotations

import threading
import time

import pytest
from zenoh_pair import free_endpoint

from bus_schema.zenoh.session import ZenohSession


@pytest.mark.parametrize("low_latency", [True, False])
def test_who_is_connected_while_others_come_and_go(low_latency: bool) -> None:
    endpoint, is_over = free_endpoint(), threading.Event()
    session = ZenohSession([endpoint], [], low_latency=low_latency)

    def come_and_go() -> None:
        for _ in range(60):
            ZenohSession([], [endpoint], low_latency=low_latency).close()
        is_over.set()

    others = threading.Thread(target=come_and_go)
    others.start()
    while not is_over.is_set():
        session.connected()  # once panicked within zenoh, which no `except Exception` catches
    others.join()
    lasting = ZenohSession([], [endpoint], low_latency=low_latency)
    assert wait_for(session, {lasting.identifier})
    assert wait_for(lasting, {session.identifier})
    lasting.close()
    assert wait_for(session, set())
    session.close()


def wait_for(session: ZenohSession, expected: set[str]) -> bool:
    give_up_s = time.monotonic() + 10.0
    while session.connected() != expected and time.monotonic() < give_up_s:
        time.sleep(0.01)
    return session.connected() == expected

"""What a session knows of its connections, and waits for."""

from __future__ import annotations

import os
import socket
import struct
import threading
from contextlib import suppress
from pathlib import Path

import pytest

from bus_schema.zenoh.bundle_mailbox import Mailbox
from bus_schema.zenoh.lingering import never_linger
from bus_schema.zenoh.session import Delivery, SessionError, ZenohSession
from tests.waiting import await_true, free_endpoint


@pytest.mark.parametrize("low_latency", [True, False])
def test_connected_peers_follow_arrivals_and_departures(low_latency: bool) -> None:
    endpoint, is_over = free_endpoint(), threading.Event()
    session = ZenohSession([endpoint], [], low_latency=low_latency)

    def come_and_go() -> None:
        for _ in range(15):
            ZenohSession([], [endpoint], low_latency=low_latency).close()
        is_over.set()

    others = threading.Thread(target=come_and_go)
    others.start()
    while not is_over.is_set():
        session.connected()  # once panicked within zenoh, which no `except Exception` catches
    others.join()
    lasting = ZenohSession([], [endpoint], low_latency=low_latency)
    await_true(lambda: session.connected() == {lasting.identifier})
    await_true(lambda: lasting.connected() == {session.identifier})
    lasting.close()
    await_true(lambda: session.connected() == set())
    session.close()


@pytest.mark.parametrize("lossless", [True, False])
def test_knock_ends_a_wait_and_is_no_delivery(lossless: bool) -> None:
    session = ZenohSession([], [], low_latency=True)
    inbox = session.inbox("a/key", 10, lossless=lossless)
    inbox.knock()
    assert inbox.wait() is None
    session.publisher("a/key").put(b"", b"")  # as empty as a knock
    inbox.knock()
    session.publisher("a/key").put(b"second", b"beside")
    assert inbox.wait() == Delivery(b"", b"")
    assert inbox.take() == Delivery(b"second", b"beside")
    assert inbox.take() is None
    session.close()


def test_knocks_stay_in_the_session() -> None:
    endpoint = free_endpoint()
    near = ZenohSession([endpoint], [], low_latency=True)
    far = ZenohSession([], [endpoint], low_latency=True)
    theirs = far.inbox("a/key", 10, lossless=True)
    far.announce("far/is/ready")
    is_ready = threading.Event()
    near.watch_tokens("far/*/*", lambda _token, _alive: is_ready.set())
    assert is_ready.wait(60.0)
    near.inbox("a/key", 10, lossless=True).knock()
    near.publisher("a/key").put(b"for all", b"")
    assert theirs.wait() == Delivery(b"for all", b"")
    for session in (near, far):
        session.close()


def test_closing_a_connection_waits_for_no_peer() -> None:
    endpoint, before = free_endpoint(), len(sockets())
    near = ZenohSession([endpoint], [], low_latency=False)
    far = ZenohSession([], [endpoint], low_latency=False)
    await_true(lambda: near.connected() == {far.identifier})
    await_true(lambda: far.connected() == {near.identifier})
    open_now = sockets()
    assert len(open_now) >= before + 3  # one listens, two are connected
    assert not any(lingers for lingers in open_now.values())
    for session in (near, far):
        session.close()


def test_looking_at_what_is_open_leaves_nothing_open(tmp_path: Path) -> None:
    with socket.socket(), (tmp_path / "file").open("w"), socket.socket(socket.AF_UNIX) as named:
        named.bind(str(tmp_path / "named"))
        handle = os.open(tmp_path / "named", os.O_PATH)  # names a socket, and is none
        never_linger()
        before = entries()
        never_linger()
        assert entries() <= before
        os.close(handle)


def entries() -> set[str]:
    return {entry.name for entry in Path("/dev/fd").iterdir()}


def sockets() -> dict[str, bool]:
    """The sockets of this process, and whether closing each may wait."""
    found = {}
    for entry in filter(Path.is_socket, Path("/dev/fd").iterdir()):
        with (
            suppress(OSError),  # a thread of an earlier session has closed it meanwhile
            socket.fromfd(int(entry.name), socket.AF_INET, socket.SOCK_STREAM) as one,
        ):
            option = one.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, 8)
            found[entry.name] = bool(struct.unpack("ii", option)[0])
    return found


def test_full_mailbox_drops_the_oldest_or_has_senders_wait() -> None:
    session = ZenohSession([], [], low_latency=False)
    newest = Mailbox(session, "full/newest", most_bytes=5000, lossless=False)
    publisher = session.publisher("full/newest")
    for number in range(10):
        publisher.put(bytes([number]) * 1000, b"")
    taken = [delivery.payload[0] for _, delivery in iter(newest.take, None)]
    assert taken == [7, 8, 9]
    assert newest.dropped == 7
    every = Mailbox(session, "full/every", most_bytes=5000, lossless=True)
    publisher = session.publisher("full/every")
    sender = threading.Thread(
        target=lambda: [publisher.put(bytes([number]) * 1000, b"") for number in range(10)]
    )
    sender.start()
    found: list[int] = []
    while len(found) < 10:
        delivery = every.take()
        found += [] if delivery is None else [delivery[1].payload[0]]
    sender.join()
    assert found == list(range(10))
    session.close()


def test_taken_endpoint_is_named_once_and_without_zenohs_sources() -> None:
    endpoint = free_endpoint()
    first = ZenohSession([endpoint], [], low_latency=False)
    with pytest.raises(SessionError) as caught:
        ZenohSession([endpoint], [], low_latency=False)
    first.close()
    port = endpoint.rpartition(":")[2]
    assert str(caught.value).count(port) == 1
    assert str(caught.value).startswith(f"cannot listen at {endpoint}: Address already in use")
    assert "/" not in str(caught.value).removeprefix(f"cannot listen at {endpoint}")

"""The relay passes every byte on, none sooner than it says."""

from __future__ import annotations

import random
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import suppress

import pytest

from deploy.run.processes.relay import DelayedStream, DelayRelay

DELAY_NS = 24_000_000
HANG_S = 30.0


class Stream:
    """A delayed stream between two ends, both in the test's hands."""

    def __init__(self) -> None:
        self.sender, source = socket.socketpair()
        sink, self.receiver = socket.socketpair()
        for each in (self.sender, self.receiver):
            each.settimeout(HANG_S)
        self.stream = DelayedStream(source, sink, DELAY_NS)
        steps = (self.stream.take_in, self.stream.let_go)
        self.threads = [threading.Thread(target=step, daemon=True) for step in steps]
        self.sockets = (self.sender, source, sink, self.receiver)
        for thread in self.threads:
            thread.start()

    def has_ended(self) -> bool:
        for thread in self.threads:
            thread.join(HANG_S)
        return not any(thread.is_alive() for thread in self.threads)


@pytest.fixture
def stream() -> Iterator[Stream]:
    made = Stream()
    yield made
    for each in made.sockets:
        each.close()


def test_no_chunk_leaves_sooner_than_its_delay_and_its_lateness_is_counted(stream: Stream) -> None:
    for word in (b"first", b"second"):
        sent_ns = time.monotonic_ns()
        stream.sender.sendall(word)
        assert stream.receiver.recv(100) == word
        assert time.monotonic_ns() >= sent_ns + DELAY_NS
    stream.sender.close()
    assert stream.has_ended()
    assert stream.stream.lateness_us.total() == 2


def test_end_comes_after_all_bytes_and_as_late(stream: Stream) -> None:
    stream.sender.sendall(b"last words")
    closed_ns = time.monotonic_ns()
    stream.sender.close()
    assert stream.receiver.recv(100) == b"last words"
    assert stream.receiver.recv(100) == b""
    assert time.monotonic_ns() >= closed_ns + DELAY_NS


def test_every_byte_comes_through_a_receiver_that_takes_little_at_a_time(stream: Stream) -> None:
    sent = random.Random(1).randbytes(2_000_000)
    sending = threading.Thread(target=stream.sender.sendall, args=(sent,), daemon=True)
    sending.start()
    heard = bytearray()
    while len(heard) < len(sent) and (chunk := stream.receiver.recv(30_000)):
        heard += chunk
    assert bytes(heard) == sent


def test_sender_is_held_up_where_nobody_reads(stream: Stream) -> None:
    stream.sender.settimeout(0.5)
    accepted = 0
    with suppress(TimeoutError):
        while accepted < 16 << 20:
            accepted += stream.sender.send(bytes(1 << 16))
    assert accepted < 8 << 20


def test_receiver_that_has_gone_ends_the_stream(stream: Stream) -> None:
    stream.receiver.close()
    stream.sender.sendall(b"to nobody")
    assert stream.has_ended()


def test_connections_are_passed_on_both_ways_and_end() -> None:
    over = threading.Event()
    with (
        socket.create_server(("127.0.0.1", 0)) as target,
        socket.create_server(("127.0.0.1", 0)) as listener,
    ):
        relay = DelayRelay(listener, target.getsockname()[:2], 0)
        relaying = threading.Thread(target=relay.run, args=(over.is_set,), daemon=True)
        relaying.start()
        near = socket.create_connection(listener.getsockname()[:2], HANG_S)
        far, _ = target.accept()
        far.settimeout(HANG_S)
        with near, far:
            near.sendall(b"state")
            assert far.recv(100) == b"state"
            far.sendall(b"command")
            assert near.recv(100) == b"command"
            near.close()
            assert far.recv(100) == b""
        over.set()
        relaying.join(HANG_S)
    counts = relay.counts()
    assert counts["chunks"] == 2
    assert counts["lateness_us"]["max"] >= 0

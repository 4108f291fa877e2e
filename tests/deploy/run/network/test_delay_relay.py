"""The relay holds bytes back for exactly as long as it says, by a clock that the tests move."""

from __future__ import annotations

import contextlib
import random
import socket
from collections.abc import Iterator

import pytest

from deploy.run.network.delay_relay import DelayedStream, DelayRelay

DELAY_NS = 24_000_000


class HandClock:
    """A clock that is moved by hand."""

    def __init__(self) -> None:
        self.ns = 0

    def __call__(self) -> int:
        return self.ns


class Stream:
    """A delayed stream between two ends, both in the test's hands."""

    def __init__(self) -> None:
        self.sender, source = socket.socketpair()
        sink, self.receiver = socket.socketpair()
        for each in (self.sender, source, sink, self.receiver):
            each.setblocking(False)
        self.clock = HandClock()
        self.late_ns: list[int] = []
        self.stream = DelayedStream(source, sink, DELAY_NS, self.late_ns.append)

    def send(self, data: bytes, at_ns: int) -> None:
        self.clock.ns = at_ns
        self.sender.sendall(data)
        self.stream.take_in(self.clock)

    def received(self, at_ns: int) -> bytes | None:
        """What has come out by then; None if nothing has."""
        self.clock.ns = at_ns
        self.stream.let_go(self.clock)
        try:
            return self.receiver.recv(1 << 20)
        except BlockingIOError:
            return None

    def close(self) -> None:
        for each in (self.sender, self.stream.source, self.stream.sink, self.receiver):
            each.close()


@pytest.fixture
def stream() -> Iterator[Stream]:
    made = Stream()
    yield made
    made.close()


def test_stream_keeps_distances_and_says_how_late_it_was(stream: Stream) -> None:
    stream.send(b"first", 0)
    stream.send(b"second", 1_000_000)
    assert stream.stream.next_due_ns == DELAY_NS
    assert stream.received(DELAY_NS - 1) is None
    assert stream.received(DELAY_NS) == b"first"
    assert stream.received(DELAY_NS + 999_999) is None
    assert stream.received(DELAY_NS + 1_300_000) == b"second"
    assert stream.late_ns == [0, 300_000]


def test_end_comes_after_all_bytes_and_as_late(stream: Stream) -> None:
    stream.send(b"last words", 0)
    stream.sender.close()
    stream.clock.ns = 1_000
    stream.stream.take_in(stream.clock)
    assert not stream.stream.wants_to_read
    assert stream.received(DELAY_NS) == b"last words"
    assert not stream.stream.is_over
    assert stream.received(DELAY_NS + 1_000) == b""
    assert stream.stream.is_over


def test_every_byte_comes_through_a_receiver_that_takes_little_at_a_time(stream: Stream) -> None:
    sent = random.Random(1).randbytes(2_000_000)
    heard = bytearray()
    offset = 0
    for step in range(100_000):
        stream.clock.ns = step * 1_000_000
        if offset < len(sent):
            with contextlib.suppress(BlockingIOError):
                offset += stream.sender.send(sent[offset : offset + 30_000])
        if stream.stream.wants_to_read:
            stream.stream.take_in(stream.clock)
        if (chunk := stream.received(stream.clock.ns)) is not None:
            heard += chunk
        if len(heard) == len(sent):
            break
    assert bytes(heard) == sent


def test_sender_is_held_up_where_nobody_reads(stream: Stream) -> None:
    stream.sender.setblocking(False)
    accepted = 0
    for _ in range(1_000):
        try:
            accepted += stream.sender.send(bytes(1 << 16))
        except BlockingIOError:
            if not stream.stream.wants_to_read:
                break
        if stream.stream.wants_to_read:
            stream.stream.take_in(stream.clock)
    assert not stream.stream.wants_to_read
    assert accepted < 8 << 20


def test_receiver_that_has_gone_ends_the_stream(stream: Stream) -> None:
    stream.send(b"to nobody", 0)
    stream.receiver.close()
    stream.clock.ns = DELAY_NS
    stream.stream.let_go(stream.clock)
    assert stream.stream.is_over
    assert not stream.stream.wants_to_read


def test_connections_are_passed_on_both_ways_and_end() -> None:
    """By the real clock, without delay: what goes in comes out, and nothing is left behind."""
    with (
        socket.create_server(("127.0.0.1", 0)) as target,
        socket.create_server(("127.0.0.1", 0)) as listener,
    ):
        relay = DelayRelay(listener, target.getsockname()[:2], 0)
        near = socket.create_connection(listener.getsockname()[:2], 5.0)
        relay.step(5.0)
        far, _ = target.accept()
        with near, far:
            near.sendall(b"state")
            relay.step(5.0)
            assert far.recv(100) == b"state"
            far.sendall(b"command")
            relay.step(5.0)
            assert near.recv(100) == b"command"
            near.close()
            relay.step(5.0)
            assert far.recv(100) == b""
    assert relay.chunks == 2
    assert relay.lateness_us()["max"] >= 0

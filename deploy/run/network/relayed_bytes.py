"""Bytes on their way through a relay: one direction of it, datagrams, and streams of connections.

Datagrams can be lost, doubled, and overtake each other. A stream of bytes cannot, as with TCP: what
came after a lost chunk waits at the receiver until that is sent again. It is so after some time, or
once three later ones have arrived and the receiver has had time to say so.
"""

from __future__ import annotations

import contextlib
import socket
from collections import Counter, deque
from collections.abc import Callable
from typing import NamedTuple, Protocol

from plant_emulator.channel.channel import NEVER_NS, Channel

CHUNK_BYTES = 1 << 16
MOST_BYTES = 1 << 22
"""A receiver that does not read holds up its sender beyond so much."""
RESEND_NS = 200_000_000
"""TCP of Linux sends again what was not acknowledged, after so much time or more."""
_DUPLICATE_ANSWERS = 3


class Sink(Protocol):
    """Destination of bytes."""

    def pass_on(self, chunk: Chunk, now_ns: int) -> None:
        """Send what is due now."""


class Chunk(NamedTuple):
    """Bytes on their way.

    Attributes:
        sink: where they leave.
        data: the bytes; empty for the end of a stream.
        number: of a chunk of a stream, from 0.
    """

    sink: Sink
    data: bytes
    number: int = 0


class Direction:
    """One direction of a relay.

    Args:
        channel: what happens to chunks.

    Attributes:
        lateness_us: how much later than due chunks left, each with its count.
    """

    def __init__(self, channel: Channel[Chunk]) -> None:
        self.channel = channel
        self.lateness_us: Counter[int] = Counter()

    def let_go(self, now_ns: Callable[[], int]) -> None:
        """Send on what is due."""
        while self.channel.is_due_before(now_ns() + 1):
            due_ns, chunk = self.channel.receive()
            chunk.sink.pass_on(chunk, now_ns())
            self.lateness_us[(now_ns() - due_ns) // 1000] += 1


class DatagramSink:
    """Destination of datagrams; an address of None is the one that the socket is connected to."""

    def __init__(self, sink: socket.socket, address: tuple[str, int] | None) -> None:
        self._sink, self._address = sink, address

    def pass_on(self, chunk: Chunk, now_ns: int) -> None:  # noqa: ARG002 (for streams)
        with contextlib.suppress(OSError):  # no receiver: as on any network, it is lost
            if self._address is None:
                self._sink.send(chunk.data)
            else:
                self._sink.sendto(chunk.data, self._address)


class RelayedStream:
    """One direction of a connection; both sockets do not block.

    Args:
        source: where bytes come from.
        sink: where they go.
        direction: what happens to them between.
        answer_ns: how long the receiver takes to say that something is missing.

    Attributes:
        has_ended: whether the end was passed on.
    """

    def __init__(
        self, source: socket.socket, sink: socket.socket, direction: Direction, answer_ns: int
    ) -> None:
        self.source, self.sink, self._direction = source, sink, direction
        self._answer_ns = answer_ns
        self._lost: dict[int, tuple[int, bytes]] = {}  # when to send again, and what
        self._early: dict[int, bytes] = {}  # arrived before what was sent earlier
        self._leaving: deque[bytes] = deque()  # due, but the receiver does not read
        self._held_bytes, self._sent, self._passed = 0, 0, 0
        self._is_read_out = self.has_ended = False

    @property
    def wants_more(self) -> bool:
        """Whether the source is to be read."""
        return self._held_bytes < MOST_BYTES and not self._is_read_out

    @property
    def is_blocked(self) -> bool:
        """Whether it waits for the receiver to read."""
        return bool(self._leaving)

    @property
    def resend_ns(self) -> int:
        """Time at which a lost chunk is sent again; `NEVER_NS` if none was lost."""
        return min((due_ns for due_ns, _ in self._lost.values()), default=NEVER_NS)

    def take_in(self, now_ns: int) -> None:
        """Read a chunk; a broken connection ends as one that is closed."""
        try:
            data = self.source.recv(CHUNK_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        self._is_read_out = not data
        self._held_bytes += len(data)
        self._send(self._sent, data, now_ns)
        self._sent += 1

    def resend(self, now_ns: int) -> None:
        """Send again what was lost long enough ago."""
        for number, (due_ns, data) in list(self._lost.items()):
            if due_ns <= now_ns:
                del self._lost[number]
                self._send(number, data, now_ns)

    def _send(self, number: int, data: bytes, now_ns: int) -> None:
        if not self._direction.channel.send(Chunk(self, data, number), now_ns, len(data)):
            self._lost[number] = now_ns + RESEND_NS, data

    def pass_on(self, chunk: Chunk, now_ns: int) -> None:
        if chunk.number < self._passed:  # a copy
            return
        self._early[chunk.number] = chunk.data
        while self._passed in self._early:
            self._leaving.append(self._early.pop(self._passed))
            self._passed += 1
        if self._lost and len(self._early) >= _DUPLICATE_ANSWERS:
            third_newest = sorted(self._early)[-_DUPLICATE_ANSWERS]
            for number, (due_ns, data) in self._lost.items():
                if number < third_newest:
                    self._lost[number] = min(due_ns, now_ns + self._answer_ns), data
        self.flush()

    def flush(self) -> None:
        """Send what the receiver takes; if it is gone, nothing more is read."""
        try:
            while self._leaving:
                data = self._leaving[0]
                if not data:
                    self.sink.shutdown(socket.SHUT_WR)
                    self.has_ended = True
                sent = self.sink.send(data) if data else 0
                self._held_bytes -= sent
                self._leaving[0] = data[sent:]
                if sent == len(data):
                    self._leaving.popleft()
        except BlockingIOError:
            return
        except OSError:
            self._leaving.clear()
            self._is_read_out = self.has_ended = True
